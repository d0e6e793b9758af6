// Positions on the screen.

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

function onLens(pose, point) {
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

function drawMarks({ pose, view, found }) {
  const drawn = outline(1.2);
  if (rim.dataset.drawn !== drawn) {
    rim.dataset.drawn = drawn;
    for (const path of [...marks.querySelectorAll("path"), ...rim.querySelectorAll(":scope > path")]) path.setAttribute("d", drawn);
    const { mm } = region(), [foot, knob] = [HALF + 0.035 * lens.size, HALF + 0.1 * lens.size].map((y) => -y / mm);
    rim.querySelector("line").setAttribute("y2", (foot - knob).toFixed(1));
    rim.querySelector(".mlens-handle").setAttribute("transform", `translate(0 ${knob.toFixed(1)})`);
  }
  marks.style.transform = place(homePose(view));
  rim.style.transform = place(pose);
  stage.classList.toggle("mlens-found", found);
}
