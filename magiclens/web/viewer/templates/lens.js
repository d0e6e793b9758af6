// Unpacks the lens: the heights of all vertices from the coefficients of each facet, as packed by packing.py.

function bytes(text) {
  const raw = atob(text);
  const found = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) found[i] = raw.charCodeAt(i);
  return found;
}

async function inflated(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Polynomials over k evenly spaced points; row d has degree d. Gram-Schmidt step by step as in packing.py: at high
// degrees another method would round differently, and heights would be wrong.
function orthonormalPolynomials(k) {
  const rows = [];
  for (let degree = 0; degree < k; degree++) {
    const row = Float64Array.from({ length: k }, (_, i) => {
      const x = (2 * i) / (k - 1) - 1;
      return degree === 0 ? 1 : x * rows[degree - 1][i];
    });
    for (let again = 0; again < 2; again++) {
      for (const other of rows) {
        let share = 0;
        for (let i = 0; i < k; i++) share += row[i] * other[i];
        for (let i = 0; i < k; i++) row[i] -= share * other[i];
      }
    }
    const norm = Math.hypot(...row);
    rows.push(row.map((value) => value / norm));
  }
  return rows;
}

// Whole numbers whose lowest bytes come first, then the second ones, and so on; 0, 1, 2, 3, .. mean 0, -1, 1, -2, ..
function integers(content) {
  const count = content.length / 4, found = new Int32Array(count);
  for (let i = 0; i < count; i++) {
    const folded = content[i] | (content[i + count] << 8) | (content[i + 2 * count] << 16) | (content[i + 3 * count] << 24);
    found[i] = (folded >>> 1) ^ -(folded & 1);
  }
  return found;
}

// All heights on the grid lines, row 0 at +y, in the coordinate w of top.glsl. Around the facets there is one more line
// on each side for the rim, which continues the slope of the outermost micro-facets.
async function unpack(lens, { heights, step, eye, base }) {
  const n = lens.facets, k = lens.microfacets + 1, side = n * k + 2, basis = orthonormalPolynomials(k);
  const coefficients = integers(await inflated(bytes(heights)));
  const grid = new Float32Array(side * side), half = new Float64Array(k * k);
  for (let facet = 0; facet < n * n; facet++) {
    const top = Math.floor(facet / n) * k + 1, left = (facet % n) * k + 1;
    half.fill(0);
    for (let p = 0, at = facet; p < k; p++) {
      for (let q = 0; q < k; q++, at += n * n) {
        const c = coefficients[at] * step;
        if (c) for (let i = 0; i < k; i++) half[i * k + q] += c * basis[p][i];
      }
    }
    for (let i = 0; i < k; i++) {
      for (let j = 0; j < k; j++) {
        let h = 0;
        for (let q = 0; q < k; q++) h += half[i * k + q] * basis[q][j];
        grid[(top + i) * side + left + j] = h;
      }
    }
  }
  extend(grid, side, lens);
  const eyeDistance = eye ? eye[2] - lens.thickness : 0;
  // a height h is a logarithm: exp(h / D) = 1 + w / D, D being the distance of the cutting eye
  if (eye) for (let i = 0; i < grid.length; i++) grid[i] = eyeDistance * Math.expm1(grid[i] / eyeDistance);
  return { eye, base, grid, side, perDistance: eye ? 1 / eyeDistance : 0, ...extremes(grid, eyeDistance), ...steps(grid, side, n, k) };
}

function extend(grid, side, lens) {
  const beyond = lens.bleed ? lens.bleed + lens.wall / 2 : 0;
  const onward = (beyond / (lens.pitch - lens.wall)) * lens.microfacets;
  const bound = lens.bleed ? lens.relief : Infinity;
  const go = (to, near, next) => {
    grid[to] = Math.min(Math.max(grid[near] - onward * (grid[next] - grid[near]), -bound), bound);
  };
  const last = side - 1;
  for (let i = 1; i < last; i++) {
    go(i, side + i, 2 * side + i);
    go(last * side + i, (last - 1) * side + i, (last - 2) * side + i);
  }
  for (let i = 0; i <= last; i++) {
    go(i * side, i * side + 1, i * side + 2);
    go(i * side + last, i * side + last - 1, i * side + last - 2);
  }
}

function extremes(grid, eyeDistance) {
  let lowest = Infinity, most = -Infinity;
  for (const w of grid) {
    if (w < lowest) lowest = w;
    if (w > most) most = w;
  }
  const z = (w) => (eyeDistance ? w / (1 + w / eyeDistance) : w);
  return { lowest: z(lowest), highest: z(most) };
}

// The step that only one in two hundred points on the borders of facets exceeds.
function steps(grid, side, n, k) {
  const found = [];
  for (let facet = 1; facet < n; facet++) {
    for (let along = 1; along < side - 1; along += 2) {
      const a = facet * k, b = a + 1;
      found.push(Math.abs(grid[along * side + a] - grid[along * side + b]), Math.abs(grid[a * side + along] - grid[b * side + along]));
    }
  }
  found.sort((a, b) => a - b);
  return { highestStep: Math.max(found[Math.floor(found.length * 0.995)] || 0, 1e-3) };
}
