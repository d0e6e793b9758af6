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
  added = nextRow = 0;
  if (!still) [moved, lastMove] = [true, performance.now()];
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
}

// The canvas gets as many pixels as the picture has; the browser stretches it.
function resized(width, height) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}

function frame(now) {
  asked = 0;
  if (!table || gl.isContextLost() || !canvas.clientWidth) return;
  const moving = moved || now - lastMove < IDLE_MS; // a slow machine comes here long after the move
  if (!pace.free(now) || (moving && !moved)) return ask();
  if (tab === "solid" ? drawSolid(now, moving) : drawTable(now, moving)) rest();
  else ask();
}

// Width and height of the next picture in pixels.
function size(moving) {
  const all = pixels(1);
  return moving ? pixels(pace.scale(all[0] * all[1])) : all;
}

function shown(now, [width, height], moving) {
  pace.drawn(now, width * height, moving);
  Object.assign(progress, { pictures: progress.pictures + 1, sharp: width === pixels(1)[0] });
}

// Whether the picture is finished.
function drawSolid(now, moving) {
  const [width, height] = size(moving);
  resized(width, height);
  solid(orbit, width, height, colors(), views[current].rotation, table.sheet());
  shown(now, [width, height], moving);
  moved = false;
  return !moving;
}

// While something moves, slow machines draw fewer pixels; at rest they draw some rows at a time, and stay ready for a move.
function drawTable(now, moving) {
  if (!moving && added >= table.most) return true; // another sample would count twice
  const [width, height] = size(moving), { mm, w, middle } = region(), first = nextRow;
  const { wood, lost } = colors(), sheen = between(6 * awayFromHome(pose), 0.05, 1), samples = moving || table.most === 1 ? 1 : SAMPLES;
  const rows = Math.min(moving ? height : pace.rows(width, height), height - first);
  table.add(tableView(pose, lens, width, height, (mm * w) / width, middle), pose, { wood, lost, sheen }, added, samples, false, [first, rows]);
  moved = false;
  nextRow = (first + rows) % height;
  if (nextRow) {
    pace.drawn(now, width * rows, moving);
    return false;
  }
  resized(width, height);
  table.present(width, height);
  shown(now, [width, rows], moving);
  added = moving ? 0 : added + 1;
  return !moving && added >= table.most;
}

// Called when the picture is finished; resolves the promises of ``settled``.
function rest() {
  if (gliding || playing) return;
  for (const done of waiting) done();
  waiting = [];
}
