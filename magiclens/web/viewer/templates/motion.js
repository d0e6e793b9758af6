// Changes of the pose, and the loop that draws.

// The pose within what can still be seen and reached.
function clamped(at) {
  const half = lens.size, reach = 0.75 * at.eyeDistance;
  return {
    x: between(at.x, -half, 1.45 * half), y: between(at.y, -1.4 * half, half), angle: at.angle, lift: between(at.lift, 0, 0.6 * lens.size),
    eyeX: between(at.eyeX, -reach, reach), eyeY: between(at.eyeY, -reach, reach),
    eyeDistance: between(at.eyeDistance, 0.4 * data.distance, 2 * data.distance),
  };
}

function setPose(change) {
  pose = clamped({ ...pose, ...change });
  refresh();
}

function refresh(still = false) {
  const atHome = checkHome();
  drawMarks();
  part("hint").textContent = hint();
  say(described(atHome));
  for (const slider of SLIDERS) slider.show();
  const chosen = part("views").querySelectorAll("input")[current];
  if (chosen) chosen.checked = true;
  part("frames").value = current;
  part("frame").textContent = `Frame ${current + 1} of ${views.length}`;
  touch(still);
}

function touch(still = false) {
  added = 0;
  moved = true;
  if (!still) lastMove = performance.now();
  ask();
}

function ask() {
  if (!asked) asked = requestAnimationFrame(frame);
}

// Moves lens and eye to a pose in 0.6 s, or at once if the user wants no motion.
function glide(to) {
  cancelAnimationFrame(gliding);
  const from = { ...pose }, start = performance.now(), last = { ...to, angle: from.angle + folded(to.angle - from.angle) };
  gliding = 0;
  if (reducedMotion.matches) return setPose(last);
  const step = (now) => {
    const t = between((now - start) / 600, 0, 1), eased = t * t * (3 - 2 * t);
    gliding = t < 1 ? requestAnimationFrame(step) : 0;
    setPose(Object.fromEntries(Object.keys(from).map((key) => [key, t < 1 ? from[key] + (last[key] - from[key]) * eased : last[key]])));
  };
  gliding = requestAnimationFrame(step);
}

function show(index, move = true) {
  const other = views[index].source !== views[current].source;
  current = index;
  if (other) table?.lay(images[views[index].source]);
  if (move) glide(homePose(index));
  else refresh(true);
}

// ---- drawing

function pixels(scale) {
  const ratio = Math.min(devicePixelRatio || 1, 2) * scale;
  return [Math.max(Math.round(canvas.clientWidth * ratio), 1), Math.max(Math.round(canvas.clientHeight * ratio), 1)];
}

function fit() {
  const holder = canvas.parentElement;
  Object.assign(canvas.style, { width: `${holder.clientWidth}px`, height: `${holder.clientHeight}px` });
  const [width, height] = pixels(1);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
    touch(true);
  }
  marks.setAttribute("viewBox", `0 0 ${stage.clientWidth || 1} ${stage.clientHeight || 1}`);
}

function frame(now) {
  asked = 0;
  if (!table || gl.isContextLost() || !canvas.clientWidth) return;
  if (tab === "solid") {
    solid(orbit, canvas.width, canvas.height, colors());
    return rest();
  }
  const moving = now - lastMove < IDLE_MS;
  if (moving && !moved) return ask();
  if (moving) hurry(now);
  lastFrame = now;
  const [width, height] = pixels(moving ? coarse : 1), { mm, w, middle } = region();
  const { wood, lost } = colors(), sheen = between(6 * awayFromHome(pose), 0, 1);
  const samples = moving || table.most === 1 ? 1 : SAMPLES;
  if (added === 0 || !moving) table.add(tableView(pose, lens, width, height, (mm * w) / width, middle), pose, { wood, lost, sheen }, added, samples, false);
  table.present(canvas.width, canvas.height);
  added = moving ? 0 : added + 1;
  moved = false;
  if (moving || added < table.most) ask();
  else rest();
}

// While something moves, slow machines draw fewer pixels.
function hurry(now) {
  const spent = now - lastFrame;
  if (spent > 500) return;
  coarse = between(coarse * (spent > SLOW_MS ? 0.85 : spent < SLOW_MS / 2 ? 1.08 : 1), 0.35, 1);
}

// Called when the picture is finished; resolves the promises of ``settled``.
function rest() {
  if (gliding || playing) return;
  for (const done of waiting) done();
  waiting = [];
}
