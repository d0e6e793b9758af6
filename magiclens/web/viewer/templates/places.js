// Where things lie on the screen, where the lens belongs, and how that is said.

function region() {
  const w = stage.clientWidth || 600, h = stage.clientHeight || 400;
  const [wanted, middle] = narrow() ? [[1.5, 2.1], [0, -0.385]] : [[2.35, 1.5], [0.42, 0]];
  // the lens's place begins and ends between pixels, so that no pixel there straddles two facets
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

// A point of the lens's top, in its own frame, as the eye sees it on the plane on which the top belongs.
function seenAt(at, [x, y]) {
  const turned = (at.angle * Math.PI) / 180, c = Math.cos(turned), s = Math.sin(turned);
  const scale = at.eyeDistance / (at.eyeDistance - at.lift);
  return [at.eyeX + (at.x + c * x - s * y - at.eyeX) * scale, at.eyeY + (at.y + s * x + c * y - at.eyeY) * scale];
}

function outline(at, more) {
  const h = HALF + more, n = 0.035 * lens.size;
  const corners = [[-n, h], [0, h + n], [n, h], [h, h], [h, -h], [-h, -h], [-h, h]];
  return `M${corners.map((p) => toScreen(seenAt(at, p)).map((c) => c.toFixed(1)).join(" ")).join("L")}Z`;
}

function onLens(point) {
  const h = HALF, corners = [[-h, -h], [h, -h], [h, h], [-h, h]].map((p) => seenAt(pose, p));
  return corners.every(([x, y], k) => {
    const [u, v] = corners[(k + 1) % 4];
    return (u - x) * (point[1] - y) - (v - y) * (point[0] - x) >= 0;
  });
}

function drawMarks() {
  const { mm } = region(), [rim, handle] = [marks.querySelector(".mlens-rim path"), marks.querySelector(".mlens-handle")];
  marks.querySelector(".mlens-outline path").setAttribute("d", outline(designPose(current), 1.2 * mm));
  rim.setAttribute("d", outline(pose, 1.2 * mm));
  const [foot, knob] = [HALF + 0.035 * lens.size, HALF + 0.1 * lens.size].map((y) => toScreen(seenAt(pose, [0, y])));
  const line = handle.querySelector("line");
  ["x2", "y2"].forEach((name, k) => line.setAttribute(name, (foot[k] - knob[k]).toFixed(1)));
  handle.setAttribute("transform", `translate(${knob[0].toFixed(1)} ${knob[1].toFixed(1)})`);
  stage.classList.toggle("mlens-found", found);
}

// ---- where the lens belongs

// Whether a view has the source and the eye of the present one.
function like(view) {
  return view.source === views[current].source && view.eye.every((c, k) => Math.abs(c - views[current].eye[k]) < 1e-6);
}

// Of such views, the one whose place the lens is nearest to, and how far it is from there.
function nearest(at) {
  return views
    .map((view, index) => ({ index, off: Math.hypot(at.x, at.y), turn: Math.abs(folded(at.angle - view.rotation)), fits: like(view) }))
    .filter((place) => place.fits)
    .sort((a, b) => a.turn - b.turn || (a.index === current ? -1 : 0))[0];
}

const far = (at) => {
  const { off, turn } = nearest(at);
  return off / lens.size + turn / 90 + Math.abs(at.lift) / lens.size;
};

function snapped(at, within, turn, lift) {
  const place = nearest(at);
  if (place.off > within || place.turn > turn || at.lift > lift) return at;
  current = place.index;
  return { ...at, x: 0, y: 0, angle: at.angle - folded(at.angle - views[current].rotation), lift: 0 };
}

function findPlace() {
  const home = designPose(current), place = nearest(pose);
  const eyeOff = Math.hypot(pose.eyeX - home.eyeX, pose.eyeY - home.eyeY, pose.eyeDistance - home.eyeDistance);
  found = place.off < 0.01 && place.turn < 0.01 && pose.lift < 0.01;
  if (found) {
    current = place.index;
    seen.add(current);
  }
  return found && eyeOff < 0.01;
}

// ---- words

const words = (value, plus, minus) => (Math.abs(value) < 0.05 ? "" : `${Math.abs(value).toFixed(1).replace(/\.0$/, "")} mm ${value > 0 ? plus : minus}`);
const listed = (items, otherwise) => items.filter(Boolean).join(", ") || otherwise;

function described(atHome) {
  const turn = folded(pose.angle);
  const place = listed([words(pose.x, "right", "left"), words(pose.y, "up", "down"), words(pose.lift, "lifted", "lowered"),
    Math.abs(turn) > 0.05 && `turned ${Math.abs(turn).toFixed(0)}° ${turn > 0 ? "left" : "right"}`], "in the middle");
  const eye = listed([words(pose.eyeX, "right", "left"), words(pose.eyeY, "up", "down")], "straight above");
  if (atHome) return `In place: ${views[current].label}.`;
  const first = found ? `In place for ${views[current].label}, but seen from elsewhere` : `Lens ${place}`;
  return `${first}. Eye ${eye}, ${pose.eyeDistance.toFixed(0)} mm away.`;
}

let saying = 0;
function say(text) {
  clearTimeout(saying);
  saying = setTimeout(() => (part("readout").textContent = text), 250);
}

function hint() {
  const others = views.some((view, k) => k !== current && view.rotation !== views[current].rotation && like(view));
  if (found) return greeted && others && seen.size === 1 ? "Now turn it: there is more to see" : "";
  return greeted ? "" : "Drag the lens onto the outline";
}
