// The table as the eye sees it. Through the lens, rays are traced as the built-in tracer does, in the lens's frame, z
// counting from the reference plane. There is one path for each sample: where light splits, the stronger part goes on.
out vec4 seen;
uniform vec3 eye, origin, right, up;
uniform vec2 jitter;
uniform float thickness, lowest, highest, gap, ior, lod;
uniform vec4 base;
uniform vec4 pose;
uniform bool exact;
uniform float sheen;
uniform vec3 lost;

const int EVENTS = 8;

// The fraction of a segment at which it enters the square of the grid: 0 if it starts inside, 2 if it never enters.
float entry(vec3 a, vec3 b) {
  vec2 run = b.xy - a.xy;
  run = mix(run, vec2(1e-9), lessThan(abs(run), vec2(1e-9)));
  vec2 p = (-edge - a.xy) / run, q = (edge - a.xy) / run;
  vec2 near = min(p, q), far = max(p, q);
  float first = max(0.0, max(near.x, near.y)), last = min(1.0, min(far.x, far.y));
  return first <= last ? first : 2.0;
}

// Follows a segment through the cells until it crosses the surface, and returns its fraction there: 2 if it does not, 3
// if it leaves the grid. ``at`` is row, column, and 1 or 2 for the upper or lower triangle of the first cell, which is
// left out because the ray starts on it; 0 for none.
float march(vec3 a, vec3 b, inout ivec3 at, bool inside, out vec3 plane) {
  vec3 d = b - a;
  float here = 0.0, sense = inside ? 1.0 : -1.0;
  int most = 2 * lastLine();
  for (int crossed = 0; crossed < most; crossed++) {
    float u0 = line(at.y), u1 = line(at.y + 1), v0 = -line(at.x), v1 = -line(at.x + 1);
    float wide = u1 - u0, tall = v0 - v1;
    float outU = d.x != 0.0 ? ((d.x > 0.0 ? u1 : u0) - a.x) / d.x : 2.0;
    float outV = d.y != 0.0 ? ((d.y > 0.0 ? v0 : v1) - a.y) / d.y : 2.0;
    float leave = min(min(outU, outV), 1.0);
    float tl = height(at.x, at.y), tr = height(at.x, at.y + 1), bl = height(at.x + 1, at.y), br = height(at.x + 1, at.y + 1);
    float s0 = (a.x - u0) / wide, ds = d.x / wide, t0 = (v0 - a.y) / tall, dt = -d.y / tall;
    float bend = ds != dt ? (t0 - s0) / (ds - dt) : -1.0;
    bool split = here < bend && bend < leave;
    for (int piece = 0; piece < 2; piece++) {
      if (piece == 1 && !split) break;
      float start = piece == 0 ? here : bend, end = piece == 0 && split ? bend : leave;
      float middle = 0.5 * (start + end);
      bool upper = s0 + ds * middle > t0 + dt * middle;
      if (at.z == (upper ? 1 : 2)) continue;
      vec2 rise = upper ? vec2(tr - tl, br - tr) : vec2(br - bl, bl - tl);
      float f0 = sense * (a.z - (tl + s0 * rise.x + t0 * rise.y)), df = sense * (d.z - ds * rise.x - dt * rise.y);
      if (f0 + df * end > 0.0 && end > start) {
        at.z = upper ? 1 : 2;
        plane = vec3(rise.x / wide, -rise.y / tall, tl + s0 * rise.x + t0 * rise.y - a.z);
        return clamp(df != 0.0 ? -f0 / df : start, start, end);
      }
    }
    at.z = 0;
    if (leave >= 1.0) return 2.0;
    here = leave;
    if (outU <= outV) at.y += d.x > 0.0 ? 1 : -1;
    else at.x += d.y > 0.0 ? -1 : 1;
    if (min(at.x, at.y) < 0 || max(at.x, at.y) >= lastLine()) return 3.0;
  }
  return 2.0;
}

// From the frame of the lens to the world.
vec2 world(vec2 p) { return pose.xy + vec2(pose.z * p.x - pose.w * p.y, pose.w * p.x + pose.z * p.y); }

// The soft shadow of the lens on the table, its bottom ``gap`` above it; p in the lens's frame.
float shade(vec2 p) {
  vec2 light = vec2(pose.z * 0.45 - pose.w * 0.6, -pose.w * 0.45 - pose.z * 0.6);
  float blur = 0.025 * size + 0.3 * gap, extent = 0.46 * size;
  float near = box(p - light * gap, vec2(extent)), far = box(p - light * (gap + 0.4 * thickness), vec2(extent));
  return 1.0 - 0.3 * (1.0 - smoothstep(-blur, blur, near)) - 0.24 * (1.0 - smoothstep(-2.0 * blur, 3.0 * blur, far));
}

// The light of the table at p in the lens's frame.
vec3 table(vec2 p, bool shaded) {
  vec2 w = world(p);
  if (exact) return printed(w) ? sheet(w, lod) : vec3(0.0);
  return shaded ? ground(w, lod) * shade(p) : ground(w, lod);
}

// The direction to a bright window, in the lens's frame.
vec3 toWindow() { return normalize(vec3(0.5 * pose.w - 0.42 * pose.z, 0.5 * pose.z + 0.42 * pose.w, 1.0)); }

// The light of the room, for rays that end neither on the table nor on the source; it is brighter toward the window.
vec3 room(vec3 d) { return exact ? vec3(0.0) : lost * (1.0 + 1.1 * dot(d.xy, toWindow().xy)); }

// The light that the glass mirrors: the window and the room.
float mirrored(vec3 d) {
  vec3 window = toWindow();
  return 9.0 * smoothstep(0.93, 0.985, dot(d, window)) + 0.8 * smoothstep(-0.2, 1.0, dot(d, window));
}

// The light that comes up through the gap and the flat bottom, for a ray that goes down.
vec3 below(vec3 p, vec3 d, float weight) {
  weight *= transmittance(-d.z, 1.0 / ior);
  vec3 o = refract(d, vec3(0, 0, 1), ior);
  if (weight <= 0.0 || o.z >= 0.0) return room(d);
  vec2 foot = p.xy - d.xy * (p.z + thickness) / d.z - o.xy * gap / o.z;
  return weight * table(foot, false);
}

// The light on the ray from the eye through q; the fourth number is 0 where the ray misses the lens.
vec4 follow(vec3 q) {
  vec3 d = normalize(q - eye);
  vec3 p = eye + d * (highest + 1e-3 - eye.z) / d.z;
  vec3 a = toGrid(p), b = toGrid(p - d * (p.z + thickness) / d.z);
  float at = entry(a, b);
  if (at > 1.0) return vec4(exact ? vec3(0.0) : table(eye.xy - d.xy * (eye.z + thickness + gap) / d.z, true), 0.0);
  a = mix(a, b, at);
  p = fromGrid(a);
  ivec3 cell = ivec3(cellOf(-a.y), cellOf(a.x), 0);
  bool inside = false;
  float weight = 1.0, rim = 1.0, gleam = 0.0;
  vec3 tint = mix(vec3(1.0), vec3(0.88, 0.955, 0.95), sheen);
  float around = max(max(height(cell.x, cell.y), height(cell.x, cell.y + 1)), max(height(cell.x + 1, cell.y), height(cell.x + 1, cell.y + 1)));
  if (a.z < around && at > 0.0) {
    if (exact) return vec4(0.0);
    vec2 n2 = abs(a.x) > abs(a.y) ? vec2(sign(a.x), 0.0) : vec2(0.0, sign(a.y));
    vec3 n = normalize(vec3(n2, (edge - dot(n2, cut.xy)) * cut.z));
    weight = transmittance(max(-dot(d, n), 0.0), ior) * 0.9;
    d = refract(d, n, 1.0 / ior);
    inside = true;
    rim = 0.0;
  }
  for (int event = 0; event < EVENTS; event++) {
    if (d.z == 0.0) break;
    float to = d.z > 0.0 ? highest + 2e-3 : min(lowest, p.z) - 1e-3;
    vec3 plane;
    b = toGrid(p + d * (to - p.z) / d.z);
    at = march(a, b, cell, inside, plane);
    if (at >= 2.0) {
      if (!inside || d.z >= 0.0) break;
      vec3 foot = p - d * (p.z + thickness) / d.z;
      vec2 cellFoot = abs(toGrid(foot).xy);
      bool lands = max(cellFoot.x, cellFoot.y) <= edge || all(greaterThanEqual(foot.xy, base.xz)) && all(lessThanEqual(foot.xy, base.yw));
      if (!lands) break;
      vec3 light = below(p, d, weight);
      return vec4(rim > 0.0 ? light * tint + gleam : mix(light, room(d), 0.3) * tint, 1.0);
    }
    vec3 n = normalize(vec3(-plane.xy, 1.0 + cut.z * (a.z + plane.z - dot(plane.xy, a.xy - cut.xy))));
    a = mix(a, b, at);
    p = fromGrid(a);
    if (inside) n = -n;
    float eta = inside ? 1.0 / ior : ior, cosine = -dot(d, n);
    float share = transmittance(max(cosine, 0.0), eta);
    if (event == 0 && rim > 0.0) gleam = sheen * (1.0 - share) * mirrored(reflect(d, n));
    if (share >= 0.5) {
      d = refract(d, n, 1.0 / eta);
      inside = !inside;
      weight *= share;
    } else {
      d = d + 2.0 * cosine * n;
      weight *= 1.0 - share;
    }
  }
  return vec4(room(d) * weight + gleam, 1.0);
}

void main() {
  vec2 pixel = gl_FragCoord.xy - 0.5 + jitter;
  seen = clamp(follow(origin + right * pixel.x + up * pixel.y), 0.0, 4.0);
}
