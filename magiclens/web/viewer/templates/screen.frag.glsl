// From linear light to sRGB.
out vec4 shown;
uniform sampler2D light;
uniform vec2 screen;

void main() {
  vec3 c = clamp(texture(light, gl_FragCoord.xy / screen).rgb, 0.0, 1.0);
  shown = vec4(mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308))), 1.0);
}
