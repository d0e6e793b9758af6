// The bench on which the solid lies, and the room around it; z counts from the middle of the slab, x and y as the lens's.
uniform float thickness, gap, ior, lod;
uniform vec2 turn;
uniform vec3 back;

const vec3 WINDOW = vec3(-0.52, 0.44, 0.732);

// The light that comes from a direction: a window with a cross, a lamp behind the viewer, the ceiling, the floor.
vec3 room(vec3 d) {
  vec3 right = normalize(cross(WINDOW, vec3(0, 0, 1))), up = cross(right, WINDOW);
  float facing = dot(d, WINDOW);
  vec2 q = vec2(dot(d, right), dot(d, up)) / max(facing, 1e-3), soft = vec2(0.04);
  vec2 pane = smoothstep(vec2(0.0), soft, vec2(0.5, 0.38) - abs(q)) * smoothstep(vec2(0.015), vec2(0.04), abs(q));
  float glow = facing > 0.0 ? pane.x * pane.y : 0.0;
  float lamp = smoothstep(0.9, 0.99, dot(d, normalize(vec3(0.35, -0.75, 0.55))));
  return back * mix(0.18, 1.15, smoothstep(-0.2, 0.8, d.z)) + vec3(2.6, 2.7, 2.9) * glow + vec3(1.3, 1.2, 1.0) * lamp;
}

// How the facet above a point bundles light: a bright spot in its middle if it is curved like a burning glass.
float bundled(vec2 p) {
  if (max(abs(p.x), abs(p.y)) > 0.5 * size) return 0.0;
  int row = facetOf(-p.y) * (micro + 1) + 1, column = facetOf(p.x) * (micro + 1) + 1, by = micro / 2;
  float middle = height(row + by, column + by);
  float bend = height(row, column + by) + height(row + 2 * by, column + by) + height(row + by, column) + height(row + by, column + 2 * by);
  vec2 off = (fract((p + 0.5 * size) / pitch) - 0.5) * 2.0;
  float focus = clamp((4.0 * middle - bend) * thickness / (side * side), -1.0, 2.0);
  return focus * exp(-3.5 * dot(off, off));
}

// The light of the window that reaches the bench at p: less in the shadow of the slab, with bright spots in it.
float lit(vec2 p) {
  vec2 away = WINDOW.xy / WINDOW.z;
  float under = box(p, vec2(edge)), low = gap, high = gap + thickness;
  for (int k = 0; k < 9; k++) {  // the distance along the ray to the window is convex
    float third = (high - low) / 3.0;
    if (box(p + away * (low + third), vec2(edge)) < box(p + away * (high - third), vec2(edge))) high -= third;
    else low += third;
  }
  float near = box(p + away * 0.5 * (low + high), vec2(edge));
  float blur = 0.012 * size + 0.12 * gap, shadow = 1.0 - smoothstep(-blur, 3.0 * blur, near);
  float touching = 0.45 * exp(-max(under, 0.0) / (0.03 * size + gap));
  float spots = bundled(p + away * (gap + 0.9 * thickness));
  return 1.0 - shadow * (0.4 - 0.3 * spots) - touching * (1.0 - 0.5 * shadow);
}

// The light of the bench at p; it fades into the room far away.
vec3 bench(vec2 p, bool under) {
  vec2 w = vec2(turn.x * p.x - turn.y * p.y, turn.y * p.x + turn.x * p.y);
  vec3 light = ground(w, lod) * (under ? 0.95 : lit(p));
  return mix(light, back, smoothstep(1.2, 3.2, length(p) / (2.0 * sourceHalf + size)));
}

vec3 display(vec3 light) {
  vec3 c = light / (1.0 + 0.12 * light);  // highlights keep their shape
  return mix(1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
}
