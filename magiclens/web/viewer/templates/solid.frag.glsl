// Light on the solid: glass or a colour scale on the top, hatching where the solid is cut open.
in vec3 point, grid;
flat in int top;
out vec4 shown;
uniform vec3 viewer, glass;
uniform vec4 section;
uniform int coloring;
uniform float steepest, highestStep;

vec3 scale(float t) {
  t = clamp(t, 0.0, 1.0);
  vec3 a = mix(vec3(0.13, 0.20, 0.45), vec3(0.12, 0.56, 0.55), smoothstep(0.0, 0.45, t));
  return mix(mix(a, vec3(0.98, 0.83, 0.30), smoothstep(0.4, 0.8, t)), vec3(0.85, 0.24, 0.16), smoothstep(0.8, 1.0, t));
}

// The step across the nearest border of facets, mm; ``nearness`` is 1 on the border and 0 away from it.
float stepHere(out float nearness) {
  vec2 p = vec2(grid.x, -grid.y) + 0.5 * size, border = floor(p / pitch + 0.5), off = abs(p - border * pitch);
  bool upright = off.x < off.y;
  int k = int(upright ? border.x : border.y);
  nearness = 1.0 - smoothstep(0.1, 0.14, min(off.x, off.y) / pitch);
  if (k < 1 || k >= facets) return 0.0;
  int before = k * (micro + 1), along = cellOf(upright ? -grid.y : grid.x);
  float a = upright ? height(along, before) : height(before, along);
  float b = upright ? height(along, before + 1) : height(before + 1, along);
  return abs(a - b);
}

void main() {
  if (dot(section.xyz, point) > section.w) discard;
  vec3 n = normalize(cross(dFdx(point), dFdy(point)));
  vec3 toViewer = normalize(viewer - point);
  if (dot(n, toViewer) < 0.0) n = -n;
  if (!gl_FrontFacing) {
    float hatch = 0.5 + 0.5 * sin((gl_FragCoord.x + gl_FragCoord.y) * 0.55);
    shown = vec4(mix(glass * 0.5, vec3(0.98, 0.55, 0.25), 0.55 + 0.12 * hatch), 1.0);
    return;
  }
  vec3 color = glass;
  if (top == 1 && coloring == 1) color = scale(acos(clamp(n.z, 0.0, 1.0)) / steepest);
  if (top == 1 && coloring == 2) {
    float nearness, height = stepHere(nearness);
    color = mix(glass * 0.9, scale(height / highestStep), nearness);
  }
  vec3 lamp = normalize(vec3(-0.45, 0.35, 0.85));
  float light = 0.42 + 0.58 * max(dot(n, lamp), 0.0);
  float shine = pow(max(dot(reflect(-lamp, n), toViewer), 0.0), 40.0) * 0.35;
  float rim = pow(1.0 - max(dot(n, toViewer), 0.0), 3.0) * 0.25;
  shown = vec4(pow(color * light + (coloring == 0 ? shine + rim : 0.3 * shine), vec3(1.0 / 1.6)), 1.0);
}
