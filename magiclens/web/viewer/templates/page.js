// What the page holds: its elements, the data of the lens, colours. Nothing here changes.

const between = (value, low, high) => Math.min(Math.max(value, low), high);
// An angle in degrees, from -180 to 180.
const folded = (angle) => angle - 360 * Math.round(angle / 360);

const root = document.getElementById("mlens-viewer");
const part = (name) => root.querySelector(`[data-part="${name}"]`);
const data = JSON.parse(part("data").textContent);
const { lens, views } = data;
const canvas = part("canvas"), stage = part("stage"), marks = part("marks"), rim = part("rim");
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)"), dark = matchMedia("(prefers-color-scheme: dark)");
const COLORS = {
  light: { wood: [0.617, 0.527, 0.418], lost: [0.4, 0.47, 0.49], back: [0.855, 0.871, 0.896], glass: [0.4, 0.6, 0.66] },
  dark: { wood: [0.05, 0.046, 0.044], lost: [0.09, 0.11, 0.12], back: [0.014, 0.017, 0.022], glass: [0.3, 0.48, 0.54] },
};
// A projector needs the dark table: its room is dark, and light around the picture takes contrast from it.
const colors = () => (dark.matches || root.classList.contains("mlens-projected") ? COLORS.dark : COLORS.light);
const HALF = lens.size / 2 + lens.bleed;
// Half the side of the sheet, in sides of the lens; of a very large sheet only a part is shown.
const SHEET = between(lens.source_size / lens.size / 2, 0.5, 0.7);
const narrow = () => stage.clientWidth < stage.clientHeight;
