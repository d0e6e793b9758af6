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

// What is left of light on a way of so many mm inside the slab.
vec3 absorbed(float way) { return exp(-vec3(0.14, 0.035, 0.045) * way / (thickness + 0.3 * size)); }

// The light of the bench or of the room for a ray in air.
vec3 outside(vec3 p, vec3 d) {
  float low = -0.5 * thickness - gap;
  return d.z < -1e-3 && p.z >= low ? bench(p.xy + d.xy * (low - p.z) / d.z, false) : room(d);
}

// Where a ray inside the slab ends, how far away that is, and the normal there, which points inward.
vec4 inner(vec3 p, vec3 d, out vec3 n) {
  vec3 extent = vec3(edge, edge, 0.5 * thickness), along = mix(vec3(1e-6), d, greaterThan(abs(d), vec3(1e-6)));
  vec3 ways = max((sign(along) * extent - p) / along, 0.0);
  float way = min(min(ways.x, ways.y), ways.z);
  n = way == ways.z ? vec3(0, 0, -sign(d.z)) : way == ways.x ? vec3(-sign(d.x), 0, 0) : vec3(0, -sign(d.y), 0);
  return vec4(p + d * way, way);
}

// The light that a ray inside the slab brings: it is mirrored within until it leaves by the bottom, a side or the top.
vec3 inside(vec3 p, vec3 d) {
  float way = 0.0;
  for (int k = 0; k < 6; k++) {
    vec3 n;
    vec4 hit = inner(p, d, n);
    p = hit.xyz;
    way += hit.w;
    float share = transmittance(-dot(d, n), 1.0 / ior);
    if (share > 0.0) {
      vec3 o = refract(d, n, ior);
      vec3 light = n.z > 0.5 ? bench(p.xy - o.xy * gap / o.z, true) : n.z < -0.5 ? room(o) : outside(p, o);
      return absorbed(way) * mix(room(reflect(d, n)), light, share);
    }
    d = reflect(d, n);
  }
  return absorbed(way) * room(d);
}

// Glass: what is mirrored on it, what is seen through it, and the light that the rounded borders of facets catch.
vec3 glassy(vec3 n, vec3 toViewer) {
  float share = transmittance(dot(n, toViewer), ior);
  vec3 light = mix(room(reflect(-toViewer, n)), inside(point, refract(-toViewer, n, 1.0 / ior)), share);
  if (top == 0) return light;
  vec2 p = vec2(grid.x, -grid.y) + 0.5 * size, off = abs(p - floor(p / pitch + 0.5) * pitch), wide = 1.4 * fwidth(p);
  float border = max(1.0 - off.x / wide.x, 1.0 - off.y / wide.y), rim = edge - max(abs(grid.x), abs(grid.y));
  border = max(border, 1.0 - rim / (1.6 * max(wide.x, wide.y)));
  return light + 0.15 * (back + 0.3) * clamp(border, 0.0, 1.0);
}

void main() {
  if (dot(section.xyz, point) > section.w) discard;
  vec3 n = normalize(cross(dFdx(point), dFdy(point)));
  vec3 toViewer = normalize(viewer - point);
  if (dot(n, toViewer) < 0.0) n = -n;
  if (!gl_FrontFacing && section.w < 1e5) {
    float hatch = 0.5 + 0.5 * sin((gl_FragCoord.x + gl_FragCoord.y) * 0.55);
    shown = vec4(mix(glass * 0.5, vec3(0.98, 0.55, 0.25), 0.55 + 0.12 * hatch), 1.0);
    return;
  }
  if (top == 0 || coloring == 0) {
    shown = vec4(display(glassy(n, toViewer)), 1.0);
    return;
  }
  vec3 color = scale(acos(clamp(n.z, 0.0, 1.0)) / steepest);
  if (coloring == 2) {
    float nearness, height = stepHere(nearness);
    color = mix(glass * 0.9, scale(height / highestStep), nearness);
  }
  vec3 lamp = normalize(vec3(-0.45, 0.35, 0.85));
  float light = 0.42 + 0.58 * max(dot(n, lamp), 0.0);
  float shine = pow(max(dot(reflect(-lamp, n), toViewer), 0.0), 40.0) * 0.1;
  shown = vec4(pow(color * light + shine, vec3(1.0 / 1.6)), 1.0);
}
