// What surfaces do to light, and the table with the sheet on it, in the frame of the sheet.
uniform sampler2D source;
uniform float sourceHalf, darkest;
uniform vec3 wood;

// The share of unpolarised light that is not reflected (Fresnel); eta is the index behind the surface over that before.
float transmittance(float cosine, float eta) {
  float k = 1.0 - (1.0 - cosine * cosine) / (eta * eta);
  if (k <= 0.0) return 0.0;
  float t = sqrt(k);
  float s = (cosine - eta * t) / (cosine + eta * t);
  float p = (eta * cosine - t) / (eta * cosine + t);
  return 1.0 - 0.5 * (s * s + p * p);
}

// The distance of p from a rectangle, negative inside.
float box(vec2 p, vec2 extent) {
  vec2 q = abs(p) - extent;
  return length(max(q, 0.0)) + min(max(q.x, q.y), 0.0);
}

bool printed(vec2 w) { return max(abs(w.x), abs(w.y)) <= sourceHalf; }

// The light of what is printed at w.
vec3 sheet(vec2 w, float lod) {
  vec2 uv = vec2(w.x, -w.y) / (2.0 * sourceHalf) + 0.5;
  return darkest + (1.0 - darkest) * textureLod(source, uv, lod).rgb;
}

// The light of the sheet, the white margin of its paper, wood.
vec3 ground(vec2 w, float lod) {
  float offPaper = box(w, vec2(1.05 * sourceHalf));
  float grain = 0.985 + 0.015 * sin(w.y * 0.9 + 2.0 * sin(w.x * 0.021) + sin(w.y * 0.17)) * sin(w.x * 0.013 + w.y * 0.31);
  vec3 wooden = wood * grain * (1.0 - 0.3 * exp(-max(offPaper, 0.0) / (0.03 * sourceHalf)));
  return printed(w) ? sheet(w, lod) : mix(vec3(0.93), wooden, smoothstep(-0.1, 0.1, offPaper));
}
