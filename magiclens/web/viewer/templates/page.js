// State that all parts share: elements of the page, the pose of lens and eye, the orbit of the camera around the solid.

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
const colors = () => (dark.matches ? COLORS.dark : COLORS.light);
const between = (value, low, high) => Math.min(Math.max(value, low), high);
// An angle in degrees, from -180 to 180.
const folded = (angle) => angle - 360 * Math.round(angle / 360);
const HALF = lens.size / 2 + lens.bleed;
// Within these distances of its home, in mm and degrees, a lens that is dragged snaps into it.
const NEAR = 0.05 * lens.size, NEAR_ANGLE = 15, NEAR_LIFT = 4;
// Without a move for IDLE_MS the picture is refined.
const IDLE_MS = 160;

let tab = "table", current = 0, gl = null, table = null, solid = null, pace = null, images = [];
let pose = homePose(0), orbit = startOrbit(), found = false, greeted = false;
const seen = new Set();
// Of the sample that is being added: its number, and the next row to draw.
let added = 0, nextRow = 0, lastMove = -1e9, moved = false, asked = 0, gliding = 0, playing = 0;
let waiting = [];
// Pictures that were shown so far, and whether the last one had all pixels.
const progress = { pictures: 0, sharp: false };

// The home of a view: the pose in which its target appears.
function homePose(index) {
  const view = views[index], [x, y, z] = view.eye;
  return { x: 0, y: 0, angle: view.rotation, lift: 0, eyeX: x, eyeY: y, eyeDistance: z - lens.thickness };
}

function startOrbit() {
  return { around: -28, above: 52, far: 3.6, cut: 100, cutAngle: 90, coloring: 0 };
}

const narrow = () => stage.clientWidth < stage.clientHeight;

// Half the side of the sheet, in sides of the lens; of a very large sheet only a part is shown.
const SHEET = between(lens.source_size / lens.size / 2, 0.5, 0.7);

// Beside the sheet, so that all of it can be seen.
function asidePose() {
  const away = SHEET + 0.53, [x, y] = narrow() ? [0.08, -away] : [away, -0.06];
  return { ...homePose(current), x: x * lens.size, y: y * lens.size, angle: views[current].rotation - 9 };
}
