// Positions on the screen, the distance of the lens from its home, and both in words.

function region() {
  const w = stage.clientWidth || 600, h = stage.clientHeight || 400;
  const along = 2 * SHEET + 1.4, broad = Math.max(1.5, 2 * SHEET + 0.3), off = 0.46;
  const [wanted, middle] = narrow() ? [[broad, along], [0, -off]] : [[along, broad], [off, 0]];
  // the square of the lens at home begins and ends between pixels, so that no pixel straddles two facets
  const across = Math.floor(Math.min(w / wanted[0], h / wanted[1])), mm = lens.size / across;
  const corner = [w, h].map((pixels, k) => Math.round(pixels / 2 - (0.5 + (k ? -1 : 1) * middle[k]) * across));
  return { w, h, mm, middle: [(w / 2 - corner[0] - across / 2) * mm, (corner[1] + across / 2 - h / 2) * mm] };
}

function toScreen([x, y]) {
  const { w, h, mm, middle } = region();
  return [(x - middle[0]) / mm + w / 2, h / 2 - (y - middle[1]) / mm];
}

function fromEvent(event) {
  const { w, h, mm, middle } = region(), box = canvas.getBoundingClientRect();
  return [(event.clientX - box.left - w / 2) * mm + middle[0], (h / 2 - (event.clientY - box.top)) * mm + middle[1]];
}

// Where the eye sees a point of the lens's top, given in the lens's frame, on the plane of the top at home.
function seenAt(at, [x, y]) {
  const turned = (at.angle * Math.PI) / 180, c = Math.cos(turned), s = Math.sin(turned);
  const scale = at.eyeDistance / (at.eyeDistance - at.lift);
  return [at.eyeX + (at.x + c * x - s * y - at.eyeX) * scale, at.eyeY + (at.y + s * x + c * y - at.eyeY) * scale];
}

// The outline of a lens at home, in pixels from the middle of the lens.
function outline(more) {
  const { mm } = region(), h = HALF / mm + more, n = (0.035 * lens.size) / mm;
  const corners = [[-n, -h], [0, -h - n], [n, -h], [h, -h], [h, h], [-h, h], [-h, -h]];
  return `M${corners.map((p) => p.map((c) => c.toFixed(1)).join(" ")).join("L")}Z`;
}

function onLens(point) {
  const h = HALF, corners = [[-h, -h], [h, -h], [h, h], [-h, h]].map((p) => seenAt(pose, p));
  return corners.every(([x, y], k) => {
    const [u, v] = corners[(k + 1) % 4];
    return (u - x) * (point[1] - y) - (v - y) * (point[0] - x) >= 0;
  });
}

// Where the eye sees the lens on the screen. As it moves, its lines are only moved: to draw them again takes long without a GPU.
function place(at) {
  const [x, y] = toScreen(seenAt(at, [0, 0])), scale = at.eyeDistance / (at.eyeDistance - at.lift);
  return `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) rotate(${-at.angle}deg) scale(${scale})`;
}

function drawMarks() {
  const drawn = outline(1.2);
  if (rim.dataset.drawn !== drawn) {
    rim.dataset.drawn = drawn;
    for (const path of [...marks.querySelectorAll("path"), ...rim.querySelectorAll(":scope > path")]) path.setAttribute("d", drawn);
    const { mm } = region(), [foot, knob] = [HALF + 0.035 * lens.size, HALF + 0.1 * lens.size].map((y) => -y / mm);
    rim.querySelector("line").setAttribute("y2", (foot - knob).toFixed(1));
    rim.querySelector(".mlens-handle").setAttribute("transform", `translate(0 ${knob.toFixed(1)})`);
  }
  marks.style.transform = place(homePose(current));
  rim.style.transform = place(pose);
  stage.classList.toggle("mlens-found", found);
}

// ---- the distance from home

// Whether a view has the same source and eye as the current one.
function isAlike(view) {
  return view.source === views[current].source && view.eye.every((c, k) => Math.abs(c - views[current].eye[k]) < 1e-6);
}

// Of these views the one whose home is nearest, by turning first, and how far the lens is from it.
function nearestHome(at) {
  return views
    .map((view, index) => ({ index, off: Math.hypot(at.x, at.y), turn: Math.abs(folded(at.angle - view.rotation)), fits: isAlike(view) }))
    .filter((home) => home.fits)
    .sort((a, b) => a.turn - b.turn || (a.index === current ? -1 : 0))[0];
}

// How far the lens is from the nearest home, as one number.
const awayFromHome = (at) => {
  const { off, turn } = nearestHome(at);
  return off / lens.size + turn / 90 + Math.abs(at.lift) / lens.size;
};

// The pose, or the nearest home if that is within these distances.
function snapped(at, within, turn, lift) {
  const near = nearestHome(at);
  if (near.off > within || near.turn > turn || at.lift > lift) return at;
  current = near.index;
  return { ...at, x: 0, y: 0, angle: at.angle - folded(at.angle - views[current].rotation), lift: 0 };
}

// Whether lens and eye are at home; marks the view as seen if the lens is.
function checkHome() {
  const home = homePose(current), near = nearestHome(pose);
  const eyeOff = Math.hypot(pose.eyeX - home.eyeX, pose.eyeY - home.eyeY, pose.eyeDistance - home.eyeDistance);
  found = near.off < 0.01 && near.turn < 0.01 && pose.lift < 0.01;
  if (found) {
    current = near.index;
    seen.add(current);
  }
  return found && eyeOff < 0.01;
}

// ---- in words

const inWords = (value, plus, minus) => (Math.abs(value) < 0.05 ? "" : `${Math.abs(value).toFixed(1).replace(/\.0$/, "")} mm ${value > 0 ? plus : minus}`);
const listed = (items, otherwise) => items.filter(Boolean).join(", ") || otherwise;

function described(atHome) {
  const turn = folded(pose.angle);
  const position = listed([inWords(pose.x, "right", "left"), inWords(pose.y, "up", "down"), inWords(pose.lift, "lifted", "lowered"),
    Math.abs(turn) > 0.05 && `turned ${Math.abs(turn).toFixed(0)}° ${turn > 0 ? "left" : "right"}`], "in the middle");
  const eye = listed([inWords(pose.eyeX, "right", "left"), inWords(pose.eyeY, "up", "down")], "straight above");
  if (atHome) return `In place: ${views[current].label}.`;
  const first = found ? `In place for ${views[current].label}, but seen from elsewhere` : `Lens ${position}`;
  return `${first}. Eye ${eye}, ${pose.eyeDistance.toFixed(0)} mm away.`;
}

let saying = 0;
function say(text) {
  clearTimeout(saying);
  saying = setTimeout(() => (part("readout").textContent = text), 250);
}

function hint() {
  const others = views.some((view, k) => k !== current && view.rotation !== views[current].rotation && isAlike(view));
  if (found) return greeted && others && seen.size === 1 ? "Now turn it: there is more to see" : "";
  return greeted ? "" : "Drag the lens onto the outline";
}
