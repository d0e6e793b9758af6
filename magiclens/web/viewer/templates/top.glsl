// The top of the lens: a grid of heights over the reference plane, in coordinates (u, v, w) in which its cells are upright.
// (u, v) is where the line from the cutting eye through a point meets the reference plane. w = z / (1 - z / D), where z
// counts from that plane and D is the cutting eye's distance from it (1 / D = 0 if cells are vertical). In these
// coordinates straight lines stay straight.
uniform sampler2D heights;
uniform int facets, micro;
uniform float pitch, side, size, edge;
uniform vec3 cut;

int lastLine() { return facets * (micro + 1) + 1; }

float line(int k) {
  if (k <= 0) return -edge;
  if (k >= lastLine()) return edge;
  int facet = (k - 1) / (micro + 1);
  int within = k - 1 - facet * (micro + 1);
  return (float(facet) + 0.5) * pitch - 0.5 * size + (float(within) / float(micro) - 0.5) * side;
}

int facetOf(float u) { return clamp(int(floor((u + 0.5 * size) / pitch)), 0, facets - 1); }

int cellOf(float u) {
  int facet = facetOf(u);
  float local = u - (float(facet) + 0.5) * pitch + 0.5 * size + 0.5 * side;
  int within = local < 0.0 ? 0 : local >= side ? micro + 1 : 1 + min(int(local / side * float(micro)), micro - 1);
  return facet * (micro + 1) + within;
}

float height(int row, int column) { return texelFetch(heights, ivec2(column, row), 0).r; }

vec3 toGrid(vec3 p) {
  float w = p.z / (1.0 - p.z * cut.z);
  return vec3(p.xy + (p.xy - cut.xy) * w * cut.z, w);
}

vec3 fromGrid(vec3 g) {
  float k = g.z * cut.z;
  return vec3(g.xy + cut.xy * k, g.z) / (1.0 + k);
}
