// Sliders, buttons, tabs and the list of views.

// ``zone`` has the least and the greatest value that the lens bears, and whether it bears the value; nothing if that is not known.
function slider(into, label, low, high, step, get, set, text, zone = () => null) {
  const box = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output"), band = document.createElement("i");
  Object.assign(input, { type: "range", min: low, max: high, step, ariaLabel: label });
  box.append(label, output, input, band);
  into.append(box);
  input.addEventListener("input", () => {
    set(Number(input.value));
    show();
  });
  const show = () => {
    const bears = zone(), good = bears !== null && bears.held;
    const [left, right] = (bears?.range ?? [low, low]).map((value) => (100 * (between(value, low, high) - low)) / (high - low));
    band.hidden = bears === null;
    Object.assign(band.style, { marginLeft: `${left}%`, width: `max(${right - left}%, 4px)` });
    input.value = get();
    output.textContent = good ? `${text(get())} \u2713` : text(get());
    output.classList.toggle("mlens-good", good);
    input.setAttribute("aria-valuetext", good ? `${text(get())}, within tolerance` : text(get()));
  };
  show();
  return { show };
}

const inMm = (value) => `${value.toFixed(1)} mm`, inDegrees = (value) => `${value.toFixed(0)}°`;
// The values of the pose around its home at which the picture loses less than 3 dB by this one alone.
function zoneOf(key) {
  const limits = data.bears[key], home = homePose(current)[key], turns = key === "angle";
  if (limits === undefined) return null;
  const away = turns ? folded(pose[key] - home) : pose[key] - home;
  return { range: limits.map((limit) => limit + (turns ? folded(home) : home)), held: limits[0] <= away && away <= limits[1] };
}

const ofPose = (key, label, low, high, text = inMm) =>
  slider(part("sliders"), label, low, high, 0.5, () => (key === "angle" ? folded(pose.angle) : pose[key]), (value) => setPose({ [key]: value }), text, () => zoneOf(key));
const SLIDERS = [
  ofPose("x", "Lens right", -lens.size, 1.45 * lens.size), ofPose("y", "Lens up", -1.4 * lens.size, lens.size),
  ofPose("angle", "Lens turned left", -180, 180, inDegrees), ofPose("lift", "Lens lifted", 0, 0.6 * lens.size),
  ofPose("eyeX", "Eye right", -0.75 * data.distance, 0.75 * data.distance), ofPose("eyeY", "Eye up", -0.75 * data.distance, 0.75 * data.distance),
  ofPose("eyeDistance", "Eye away", 0.4 * data.distance, 2 * data.distance),
];
const ofOrbit = (key, label, low, high, text) => slider(part("cuts"), label, low, high, 1, () => orbit[key], (value) => turnAbout({ [key]: value }), text);
const CUTS = [ofOrbit("cut", "Section", 0, 100, (value) => (value >= 100 ? "whole" : `at ${value} %`)), ofOrbit("cutAngle", "Direction of the section", 0, 180, inDegrees)];

function startAgain() {
  greeted = false;
  seen.clear();
  glide(asidePose());
}

function choose(name) {
  tab = name;
  for (const other of ["table", "solid"]) {
    const button = document.getElementById(`mlens-tab-${other}`), chosen = other === name;
    button.setAttribute("aria-selected", chosen);
    button.tabIndex = chosen ? 0 : -1;
    document.getElementById(`mlens-panel-${other}`).hidden = !chosen;
  }
  part(name === "solid" ? "bench" : "stage").prepend(canvas);
  canvas.setAttribute("aria-label", name === "solid" ? "The lens as a solid" : "The table, seen from above: a source, and the lens upon it");
  canvas.setAttribute("aria-describedby", name === "solid" ? "mlens-solid-keys" : "mlens-keys");
  stop();
  fit();
  touch(true);
}

function legend() {
  orbit.coloring = Number(root.querySelector('[name="mlens-colors"]:checked').value);
  part("legend").hidden = orbit.coloring === 0;
  part("most").textContent = orbit.coloring === 1 ? `${lens.steepest.toFixed(0)}°` : `${solid.highestStep.toFixed(2)} mm`;
  touch(true);
}

function stop() {
  clearInterval(playing);
  playing = 0;
  part("play").setAttribute("aria-pressed", "false");
  part("play").textContent = "Play";
  ask();
}

function play() {
  if (playing) return stop();
  playing = setInterval(() => show((current + 1) % views.length, false), 350);
  part("play").setAttribute("aria-pressed", "true");
  part("play").textContent = "Stop";
}

function listViews() {
  part("film").hidden = !data.film;
  part("views").hidden = data.film || views.length < 2;
  part("frames").max = views.length - 1;
  if (data.film || views.length < 2) return;
  views.forEach((view, index) => {
    const box = document.createElement("label"), input = document.createElement("input"), face = document.createElement("span"), picture = new Image();
    Object.assign(input, { type: "radio", name: "mlens-view", value: index, checked: index === 0 });
    Object.assign(picture, { src: view.target, alt: "" });
    face.append(picture, view.label);
    box.append(input, face);
    input.addEventListener("change", () => show(index));
    part("views").append(box);
  });
}

function addListeners() {
  canvas.addEventListener("pointerdown", press);
  for (const name of ["pointermove", "pointerup", "pointercancel"]) canvas.addEventListener(name, name === "pointermove" ? drag : release);
  // a finger that holds the lens does not scroll the page; a finger on the bare table does
  canvas.addEventListener("touchstart", (event) => {
    const [finger] = event.changedTouches;
    if (tab === "solid" || grip || mover() === "eye" || onLens(fromEvent(finger))) event.preventDefault();
  }, { passive: false });
  canvas.addEventListener("touchmove", (event) => grip && event.preventDefault(), { passive: false });
  const handle = rim.querySelector(".mlens-handle");
  handle.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    held.set(event.pointerId, { at: fromEvent(event) });
    grab("turn", event);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("keydown", keyed);
  part("home").addEventListener("click", () => glide(homePose(current)));
  part("aside").addEventListener("click", startAgain);
  part("link").addEventListener("click", copyLink);
  addEventListener("hashchange", followAddress);
  part("play").addEventListener("click", play);
  part("frames").addEventListener("input", (event) => {
    stop();
    show(Number(event.target.value), false);
  });
  part("turned").addEventListener("click", () => {
    orbit = { ...startOrbit(), coloring: orbit.coloring };
    for (const cut of CUTS) cut.show();
    touch(true);
  });
  for (const input of root.querySelectorAll('[name="mlens-colors"]')) input.addEventListener("change", legend);
  for (const button of root.querySelectorAll('[role="tab"]')) {
    const name = button.id.replace("mlens-tab-", "");
    button.addEventListener("click", () => choose(name));
    button.addEventListener("keydown", (event) => {
      if (!["ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) return;
      const other = event.key === "Home" ? "table" : event.key === "End" ? "solid" : name === "table" ? "solid" : "table";
      choose(other);
      document.getElementById(`mlens-tab-${other}`).focus();
    });
  }
  dark.addEventListener("change", () => touch(true));
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    table = null;
  });
  canvas.addEventListener("webglcontextrestored", () => begin().catch(trouble));
  new ResizeObserver(() => {
    fit();
    refresh(true);
  }).observe(stage);
}
