// Tiles of the quick guess: each tile of a picture shown by the patch of random discs that suits it best.
import { element } from "./server.js";

// Pixels along a tile; candidates along each axis of the search window, fewer for many tiles; how far away is looked is
// told, as a share of the sheet.
export const TILE = 8;
const CANDIDATES = 13, FEWER = 7, MANY_TILES = 1500;
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

// For each picture what is seen; one patch of the sheet has to suit all of them, each at its quarter turn.
export function matched(targets, sheet, facets, reach) {
  const side = facets * TILE, wanted = targets.map((t, k) => turned(t, side, (4 - k) % 4)), sheets = targets.map((_, k) => turned(sheet, side, (4 - k) % 4));
  const shown = targets.map(() => new Float32Array(side * side)), axis = facets * facets * targets.length > MANY_TILES ? FEWER : CANDIDATES, step = (2 * reach * side) / (axis - 1), maps = MAPS.map((map) => offsets(map, side));
  for (let y = 0; y < side; y += TILE) {
    for (let x = 0; x < side; x += TILE) {
      const to = y * side + x, half = (axis - 1) / 2;
      let best = Infinity, found = null;
      for (let k = 0; k < axis * axis; k++) {
        const [u, v] = [x + step * ((k % axis) - half), y + step * (Math.floor(k / axis) - half)].map((at) => Math.round(Math.min(Math.max(at, 0), side - TILE)));
        for (const map of maps) {
          let error = 0;
          for (let j = 0; j < wanted.length && error < best; j++) error += difference(wanted[j], to, sheets[j], v * side + u, map, maps[0]);
          if (error < best) [best, found] = [error, { from: v * side + u, map }];
        }
      }
      sheets.forEach((one, j) => maps[0].forEach((at, k) => (shown[j][to + at] = one[found.from + found.map[k]])));
    }
  }
  return shown.map((one, k) => turned(one, side, k));
}

function offsets({ scale, flip }, side) {
  const along = (k, mirrored) => Math.floor(scale * (mirrored ? TILE - 1 - k : k));
  return Int32Array.from({ length: TILE * TILE }, (_, k) => along(Math.floor(k / TILE), flip & 1) * side + along(k % TILE, flip & 2));
}

function difference(wanted, to, sheet, from, map, plain) {
  let sum = 0;
  for (let k = 0; k < map.length; k++) {
    const off = wanted[to + plain[k]] - sheet[from + map[k]];
    sum += off * off;
  }
  return sum;
}

export function canvasOf(picture, side, name) {
  const canvas = element("canvas", { width: side, height: side, role: "img", ariaLabel: `${name}: a guess of what a lens could show` });
  const image = new ImageData(side, side);
  picture.forEach((value, k) => image.data.set([value, value, value, 255], 4 * k));
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}
