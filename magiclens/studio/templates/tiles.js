// Tiles of the quick guess: each tile of a picture shown by the patch of random discs that suits it best.
// Pixels along a tile.
export const TILE = 8;
// Searches, each finer than the one before: places along each axis of the window, and how many of the maps are tried at each.
const SEARCHES = [[5, 1], [9, 4], [13, 8]];
// How a facet may show its patch: as it is, mirrored, or magnified; where each pixel of a tile comes from, from the corner.
const MAPS = [1, 0.5].flatMap((scale) => [0, 1, 2, 3].map((flip) => ({ scale, flip })));
const DISCS_MM = [0.5, 2.5], LAYERS = 4;

export async function greys(uri, side) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  const context = new OffscreenCanvas(side, side).getContext("2d");
  context.drawImage(image, 0, 0, side, side);
  return grey(context, side);
}

const grey = (context, side) => Float32Array.from({ length: side * side }, ((rgba) => (_, k) => (rgba[4 * k] + rgba[4 * k + 1] + rgba[4 * k + 2]) / 3)(context.getImageData(0, 0, side, side).data));

export function discs(side, sizeMm) {
  const context = new OffscreenCanvas(side, side).getContext("2d"), perMm = side / sizeMm, random = numbers(7);
  const [low, high] = DISCS_MM.map((mm) => mm * perMm), mean = (low * low + low * high + high * high) / 3;
  context.fillStyle = "#fff";
  context.fillRect(0, 0, side, side);
  for (let k = (LAYERS * side * side) / (Math.PI * mean); k > 0; k--) {
    context.fillStyle = random() < 0.5 ? "#000" : "#fff";
    context.beginPath();
    context.arc(random() * side, random() * side, low + random() * (high - low), 0, 7);
    context.fill();
  }
  return grey(context, side);
}

// Equal numbers each time, so that the guess changes only with what is asked.
function numbers(seed) {
  let state = seed;
  return () => (state = (state * 16807) % 2147483647) / 2147483647;
}

// A picture turned back by quarter turns: what a lens that is turned with it sees.
function turned(picture, side, quarters) {
  if (!quarters) return picture;
  const out = new Float32Array(side * side);
  for (let y = 0; y < side; y++) for (let x = 0; x < side; x++) out[y * side + x] = picture[x * side + side - 1 - y];
  return turned(out, side, (quarters + 1) % 4);
}

// The sheet as an eye sees it that looks past the edge: what lies so many pixels to the right and below. What falls off comes back.
function shifted(sheet, side, [right, below]) {
  const wrapped = (at) => ((at % side) + side) % side;
  return sheet.map((_, k) => sheet[wrapped(Math.floor(k / side) + below) * side + wrapped((k % side) + right)]);
}

// What is seen in each of some looks at a sheet. One patch has to suit all of them, each at its quarter turn and with its shift.
export class Guess {
  #best;
  #wanted;
  #sheets;
  #pixels;

  // ``looks`` have a picture, quarter turns and a shift in pixels; ``reach`` is half the window, as a share of the sheet.
  constructor(looks, sheet, facets, reach) {
    [this.facets, this.side, this.reach] = [facets, facets * TILE, reach];
    const back = ({ quarters }, picture) => turned(picture, this.side, (4 - quarters) % 4);
    this.#wanted = looks.map((look) => back(look, look.picture));
    this.#sheets = looks.map((look) => back(look, shifted(sheet, this.side, look.shift)));
    this.#best = new Float32Array(facets * facets).fill(Infinity);
    this.shown = looks.map(() => new ImageData(this.side, this.side));
    this.#pixels = this.shown.map((image) => new Uint32Array(image.data.buffer));
    this.#sheets.forEach((sheet, j) => sheet.forEach((grey, k) => (this.#pixels[j][k] = opaque(grey))));
  }

  // Finds better patches, tile by tile, and says after each how much of the work is done.
  *refined() {
    const tiles = shuffled(this.facets * this.facets), all = SEARCHES.reduce((sum, [axis, many]) => sum + axis * axis * many, 0);
    let done = 0;
    for (const [axis, many] of SEARCHES) {
      const maps = MAPS.slice(0, many).map((map) => offsets(map, this.side));
      for (const tile of tiles) {
        this.#search(tile, axis, maps);
        yield (done += (axis * axis * many) / (all * tiles.length));
      }
    }
  }

  #search(tile, axis, maps) {
    const { side, facets } = this, [x, y] = [(tile % facets) * TILE, Math.floor(tile / facets) * TILE], to = y * side + x;
    const step = (2 * this.reach * side) / (axis - 1), half = (axis - 1) / 2;
    let best = this.#best[tile], found = null;
    for (let k = 0; k < axis * axis; k++) {
      const [u, v] = [x + step * ((k % axis) - half), y + step * (Math.floor(k / axis) - half)].map((at) => Math.round(Math.min(Math.max(at, 0), side - TILE)));
      for (const map of maps) {
        let error = 0;
        for (let j = 0; j < this.#wanted.length && error < best; j++) error += difference(this.#wanted[j], to, this.#sheets[j], v * side + u, map, maps[0], best - error);
        if (error < best) [best, found] = [error, { from: v * side + u, map }];
      }
    }
    if (!found) return;
    this.#best[tile] = best;
    this.#sheets.forEach((sheet, j) => maps[0].forEach((at, k) => (this.#pixels[j][to + at] = opaque(sheet[found.from + found.map[k]]))));
  }
}

const opaque = (grey) => 0xff000000 | (Math.round(grey) * 0x10101);

// Numbers below ``many`` in an order in which neighbours do not follow each other.
function shuffled(many) {
  const random = numbers(11);
  return Array.from({ length: many }, (_, k) => [random(), k]).sort(([a], [b]) => a - b).map(([, k]) => k);
}

function offsets({ scale, flip }, side) {
  const along = (k, mirrored) => Math.floor(scale * (mirrored ? TILE - 1 - k : k));
  return Int32Array.from({ length: TILE * TILE }, (_, k) => along(Math.floor(k / TILE), flip & 1) * side + along(k % TILE, flip & 2));
}

// Of two tiles, or more than ``most``.
function difference(wanted, to, sheet, from, map, plain, most) {
  let sum = 0;
  for (let k = 0; k < map.length && sum <= most; k += TILE) {
    for (let j = k; j < k + TILE; j++) sum += (wanted[to + plain[j]] - sheet[from + map[j]]) ** 2;
  }
  return sum;
}
