// The bench and the room behind the solid.
out vec4 shown;
uniform vec3 viewer, right, up, forward;
uniform vec2 screen;

void main() {
  vec2 at = 2.0 * gl_FragCoord.xy / screen - 1.0;
  vec3 d = normalize(forward + right * at.x + up * at.y);
  float low = -0.5 * thickness - gap;
  bool down = d.z < -1e-4 && viewer.z > low;
  shown = vec4(display(down ? bench(viewer.xy + d.xy * (low - viewer.z) / d.z, false) : back), 1.0);
}
