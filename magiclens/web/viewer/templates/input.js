// Pointer and keyboard.

const held = new Map();
let grip = null;

function grab(kind, event) {
  const start = [...held.values()].map((p) => p.at);
  grip = { kind, start, raw: { ...pose }, orbit: { ...orbit }, id: event.pointerId };
}

const mover = () => root.querySelector('[name="mlens-mover"]:checked').value;

function press(event) {
  if (event.button) return;
  cancelAnimationFrame(gliding);
  gliding = 0;
  const at = fromEvent(event), touching = event.pointerType === "touch";
  const kind = tab === "solid" ? "orbit" : mover() === "eye" ? "eye" : onLens(at) ? "lens" : touching ? null : "eye";
  held.set(event.pointerId, { at });
  if (held.size === 2 && grip) grab(tab === "solid" ? "near" : "twist", event);
  else if (kind) grab(kind, event);
  else return held.delete(event.pointerId);
  canvas.setPointerCapture(event.pointerId);
  canvas.classList.add("mlens-held");
}

function drag(event) {
  if (!held.has(event.pointerId) || !grip) return;
  held.get(event.pointerId).at = fromEvent(event);
  const now = [...held.values()].map((p) => p.at), [[x0, y0]] = grip.start, [[x, y]] = now, raw = grip.raw;
  if (grip.kind === "lens") {
    const scale = (raw.eyeDistance - raw.lift) / raw.eyeDistance;
    settle({ ...raw, x: raw.x + (x - x0) * scale, y: raw.y + (y - y0) * scale });
  } else if (grip.kind === "turn") {
    const [cx, cy] = seenAt(raw, [0, 0]);
    settle({ ...raw, angle: raw.angle + ((Math.atan2(y - cy, x - cx) - Math.atan2(y0 - cy, x0 - cx)) * 180) / Math.PI });
  } else if (grip.kind === "eye") {
    setPose({ eyeX: raw.eyeX + 3 * (x - x0), eyeY: raw.eyeY + 3 * (y - y0) });
  } else if (grip.kind === "orbit") {
    const { mm } = region();
    turnAbout({ around: grip.orbit.around - (0.5 * (x - x0)) / mm, above: grip.orbit.above - (0.4 * (y - y0)) / mm });
  } else pinch(now, raw);
}

// Two fingers turn and lift the lens, or bring the solid nearer.
function pinch(now, raw) {
  if (now.length < 2 || grip.start.length < 2) return;
  const across = ([a, b]) => [b[0] - a[0], b[1] - a[1]], [before, after] = [across(grip.start), across(now)];
  const ratio = Math.hypot(...after) / Math.max(Math.hypot(...before), 1);
  if (grip.kind === "near") return turnAbout({ far: grip.orbit.far / Math.max(ratio, 0.1) });
  const turn = ((Math.atan2(after[1], after[0]) - Math.atan2(before[1], before[0])) * 180) / Math.PI;
  settle({ ...raw, angle: raw.angle + folded(turn), lift: raw.lift + (ratio - 1) * 0.4 * lens.size });
}

function settle(raw) {
  setPose(snapped(raw, NEAR, NEAR_ANGLE, NEAR_LIFT));
  greet();
}

// A user who has brought the lens home once needs no hint.
function greet() {
  greeted = greeted || found;
  part("hint").textContent = hint();
}

function release(event) {
  if (!held.delete(event.pointerId)) return;
  grip = null;
  if (!held.size) canvas.classList.remove("mlens-held");
}

function turnAbout(change) {
  orbit = { ...orbit, ...change };
  orbit.above = between(orbit.above, -89, 89);
  orbit.far = between(orbit.far, 1.6, 9);
  touch();
}

// ---- the keyboard

function keyed(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const done = tab === "solid" ? keyedSolid(event) : keyedTable(event);
  if (done) event.preventDefault();
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const WASD = { a: [-1, 0], d: [1, 0], w: [0, 1], s: [0, -1] };

function keyedTable(event) {
  const key = event.key.toLowerCase(), big = event.shiftKey ? 5 : 1, arrow = ARROWS[event.key], eye = WASD[key] || (mover() === "eye" && arrow);
  cancelAnimationFrame(gliding);
  gliding = 0;
  if (eye) setPose({ eyeX: pose.eyeX + 5 * big * eye[0], eyeY: pose.eyeY + 5 * big * eye[1] });
  else if (arrow) nudge({ x: pose.x + big * arrow[0], y: pose.y + big * arrow[1] });
  else if (key === "q" || key === "e") nudge({ angle: pose.angle + (key === "q" ? big : -big) });
  else if ("+=-_".includes(key)) nudge({ lift: Math.max(pose.lift + ("+=".includes(key) ? big : -big), 0) });
  else if (key === "enter") glide(homePose(current));
  else if (key === "r" || key === "home") startAgain();
  else return false;
  return true;
}

// A step of the keyboard snaps into a home only if it comes nearer; otherwise the lens could never leave.
function nudge(change) {
  const next = { ...pose, ...change };
  setPose(awayFromHome(next) < awayFromHome(pose) ? snapped(next, 1.5, 3, 1.5) : next);
  greet();
}

function keyedSolid(event) {
  const arrow = ARROWS[event.key], big = event.shiftKey ? 15 : 5;
  if (arrow) turnAbout({ around: orbit.around - big * arrow[0], above: orbit.above - big * arrow[1] });
  else if ("+=".includes(event.key)) turnAbout({ far: orbit.far / 1.1 });
  else if ("-_".includes(event.key)) turnAbout({ far: orbit.far * 1.1 });
  else return false;
  return true;
}
