// A quick guess of what a lens of so many facets could show: each tile from the patch of random discs that suits it best.
// It knows neither refraction nor the machine, which a draft does.
import { discs, greys, Guess, TILE } from "./tiles.js";
import { ask, element, Refused } from "./server.js";

const box = document.getElementById("preview");
const table = document.getElementById("foreseen");
const still = matchMedia("(prefers-reduced-motion: reduce)");
// Eyes of two and more views are tilted so far; refraction takes them so much past the edge, in thicknesses of the lens.
const TILT = Math.PI / 12, PAST = Math.tan(Math.asin(Math.sin(TILT) / 1.49));
// By scenario: half the window in which patches are looked for, as a share of the sheet, and how the k-th of so many pictures is looked at,
// with its shift in thicknesses. Other scenarios paint their sheets for the pictures, so that no tile has to be found.
const past = (azimuth) => [-PAST * Math.cos(azimuth), PAST * Math.sin(azimuth)];
const WAYS = {
  single: { reach: 0.1, look: () => ({ quarters: 0, shift: [0, 0] }) },
  rotating: { reach: 0.2, look: (k) => ({ quarters: k, shift: [0, 0] }) },
  "multi-view": { reach: 0.2, look: (k, many) => ({ quarters: 0, shift: past(Math.PI + (2 * Math.PI * k) / many) }) },
};
// The guess is made for so long at a time, so that the page stays alive.
const SLICE_MS = 30;
let asked = 0, forecasts = 0;

// Pictures of an order as such a lens might show them, better and better; nothing of no order.
export async function preview(order, lens) {
  const mine = ++asked;
  if (!order) return box.replaceChildren();
  const { pictures, crop, ground, contrast, scenario } = order;
  const asking = pictures.map((name) => ask("GET", `/api/previews/${name}?${new URLSearchParams({ crop, ground, contrast })}`));
  const found = await unlessLate(Promise.all(asking), () => mine !== asked);
  if (!found) return undefined;
  const reasons = element("ul", { className: "muted" }, ...found.map((one) => element("li", {}, one.reasons.join(" "))));
  const wanted = found.map((one, k) => figure(element("img", { src: one.picture, alt: `${pictures[k]}, as it is asked for` }), "As it is asked for"));
  if (!(scenario in WAYS)) return show(wanted, "The sheet will be painted for this; the draft shows how well that goes.", reasons);
  const targets = await Promise.all(found.map((one) => greys(one.picture, lens.facets * TILE)));
  return mine === asked ? guess(order, lens, { targets, wanted, reasons }, () => mine === asked) : undefined;
}

async function guess({ pictures, size, scenario }, { facets, thickness_mm: thickness }, { targets, wanted, reasons }, asksStill) {
  const side = facets * TILE, { reach, look } = WAYS[scenario], perMm = side / parseFloat(size);
  const looks = targets.map((picture, k) => ((one) => ({ picture, quarters: one.quarters, shift: one.shift.map((at) => Math.round(at * thickness * perMm)) }))(look(k, targets.length)));
  const made = new Guess(looks, discs(side, parseFloat(size)), facets, reach), canvases = looks.map((one, k) => canvas(side, pictures[k], one.quarters));
  const bar = element("progress", { max: 1, value: 0, ariaLabel: "The guess is being refined" });
  const draw = () => canvases.forEach((each, k) => each.getContext("2d").putImageData(made.shown[k], 0, 0));
  const words = "A guess, not a promise: the best patches of a sheet of dots, without refraction, seams and your machine. The draft has these, in fewer and coarser facets; the full design has them all.";
  show(wanted.flatMap((one, k) => [one, figure(canvases[k], `Guessed for ${facets} x ${facets} facets`)]), words, reasons, bar);
  draw();
  let until = performance.now() + SLICE_MS;
  for (const done of made.refined()) {
    if (performance.now() < until) continue;
    if (!still.matches) draw();
    bar.value = done;
    await new Promise((next) => setTimeout(next));
    if (!asksStill()) return;
    until = performance.now() + SLICE_MS;
  }
  draw();
  bar.remove();
  box.dataset.done = facets;
}

function show(figures, words, ...more) {
  delete box.dataset.done;
  box.replaceChildren(element("div", { className: "views" }, ...figures), element("p", { className: "muted" }, words), ...more);
}

const figure = (picture, caption) => element("figure", {}, picture, element("figcaption", {}, caption));

// What is seen by a lens that is turned stands on a canvas that is turned.
function canvas(side, name, quarters) {
  const made = element("canvas", { width: side, height: side, role: "img", ariaLabel: `${name}: a guess of what a lens could show` });
  made.style.rotate = `${-90 * quarters}deg`;
  return made;
}

// An answer, or null if it came too late, when a newer order is on the page: answers overtake each other, and so do errors.
async function unlessLate(answer, isLate) {
  try {
    const found = await answer;
    return isLate() ? null : found;
  } catch (error) {
    if (isLate()) return null;
    throw error;
  }
}

// What an order will take, in the table; facets and thickness of its lens, or nothing if the order has changed meanwhile.
export async function foresee(order, trouble) {
  const mine = ++forecasts;
  if (!order) {
    const words = trouble instanceof Refused ? trouble.errors.map((e) => e.message).join(" ") : String(trouble);
    table.tBodies[0].replaceChildren(row("Not yet", words, ""));
    return null;
  }
  const found = await unlessLate(ask("POST", "/api/forecasts", order), () => mine !== forecasts);
  if (found) table.tBodies[0].replaceChildren(...found.rows.map((each) => row(...each)));
  return found;
}

function row(label, text, color) {
  return element("tr", {}, element("th", { scope: "row" }, label), element("td", { className: color }, text));
}
