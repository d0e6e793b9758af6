// The solid without vertex data: the cells of the top, then the four sides, then the flat bottom; ``fine`` cells a facet.
uniform int fine;
uniform mat4 camera;
uniform float thickness;
uniform vec4 base;
out vec3 point, grid;
flat out int top;

int lineOf(int j) {
  int last = facets * (fine + 1) + 1;
  if (j <= 0 || j >= last) return j <= 0 ? 0 : lastLine();
  int facet = (j - 1) / (fine + 1), within = j - 1 - facet * (fine + 1);
  return 1 + facet * (micro + 1) + (within * micro + fine / 2) / fine;
}

vec3 topPoint(ivec2 at) {
  int row = lineOf(at.x), column = lineOf(at.y);
  return vec3(line(column), -line(row), height(row, column));
}

void main() {
  int cells = facets * (fine + 1) + 1, quad = gl_VertexID / 6, corner = gl_VertexID % 6;
  ivec2 c = corner == 0 || corner == 3 ? ivec2(0, 0) : corner == 1 ? ivec2(1, 0) : corner == 5 ? ivec2(0, 1) : ivec2(1, 1);
  bool low = false;
  ivec2 at;
  top = quad < cells * cells ? 1 : 0;
  if (top == 1) at = ivec2(quad / cells, quad % cells) + c;
  else if (quad < cells * cells + 4 * cells) {
    int k = quad - cells * cells, border = k / cells, along = k % cells + c.y;
    low = c.x == 1;
    at = border == 0 ? ivec2(cells, along) : border == 1 ? ivec2(cells - along, cells) : border == 2 ? ivec2(0, cells - along) : ivec2(along, 0);
  } else {
    low = true;
    at = ivec2(1 - c.x, c.y) * cells;
  }
  grid = topPoint(at);
  point = fromGrid(grid);
  if (low) point = vec3(mix(base.xz, base.yw, (grid.xy + edge) / (2.0 * edge)), -thickness);
  point.z += 0.5 * thickness;
  gl_Position = camera * vec4(point, 1.0);
}
