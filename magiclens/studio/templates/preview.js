// A quick guess of what a lens of so many facets could show: each tile from the patch of random discs that suits it best.
// It knows neither refraction nor the machine, which a draft does.
import { canvasOf, discs, greys, matched, TILE } from "./tiles.js";
import { ask, element, Refused } from "./server.js";

const box = document.getElementById("preview");
const table = document.getElementById("foreseen");
// Half the window in which patches are looked for, as a share of the sheet; other scenarios have no quick guess.
const REACH = { single: 0.1, rotating: 0.2 };
let asked = 0, forecasts = 0;

// Pictures of an order as so many facets might show them; nothing of no order.
export async function preview(order, facets) {
  const mine = ++asked;
  if (!order || !facets || !(order.scenario in REACH)) return box.replaceChildren();
  const { pictures, crop, ground, contrast, size, scenario } = order;
  const found = await Promise.all(pictures.map((name) => ask("GET", `/api/previews/${name}?${new URLSearchParams({ crop, ground, contrast })}`)));
  const targets = await Promise.all(found.map((one) => greys(one.picture, facets * TILE)));
  if (mine !== asked) return undefined;
  const shown = matched(targets, discs(facets * TILE, parseFloat(size)), facets, REACH[scenario]);
  const figures = shown.map((picture, k) => element("figure", {}, canvasOf(picture, facets * TILE, pictures[k])));
  const words = `A guess, not a promise: about what ${facets} x ${facets} facets can show. The draft knows your machine.`;
  return box.replaceChildren(
    element("div", { className: "views" }, ...figures), element("p", { className: "muted" }, words),
    element("ul", { className: "muted" }, ...found.map((one) => element("li", {}, one.reasons.join(" ")))),
  );
}

// What an order will take, in the table; the number of its facets, or nothing if the order has changed meanwhile.
export async function foresee(order, trouble) {
  const mine = ++forecasts;
  if (!order) {
    const words = trouble instanceof Refused ? trouble.errors.map((e) => e.message).join(" ") : String(trouble);
    table.tBodies[0].replaceChildren(row("Not yet", words, ""));
    return 0;
  }
  const { rows, facets } = await ask("POST", "/api/forecasts", order);
  if (mine !== forecasts) return 0;
  table.tBodies[0].replaceChildren(...rows.map((each) => row(...each)));
  return facets;
}

function row(label, text, color) {
  return element("tr", {}, element("th", { scope: "row" }, label), element("td", { className: color }, text));
}
