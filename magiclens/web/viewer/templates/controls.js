// Sliders, buttons, tabs and the list of views.

// ``bears`` gives the least and the greatest value that the lens bears, and whether it bears this one; nothing if that is not known.
function slider(into, { label, low, high, step, get, set, text, bears = () => null }) {
  const box = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output"), band = document.createElement("i");
  Object.assign(input, { type: "range", min: low, max: high, step, ariaLabel: label });
  box.append(label, output, input, band);
  into.append(box);
  const show = () => {
    const zone = bears(), good = zone !== null && zone.held;
    const [left, right] = (zone?.range ?? [low, low]).map((value) => (100 * (between(value, low, high) - low)) / (high - low));
    band.hidden = zone === null;
    Object.assign(band.style, { marginLeft: `${left}%`, width: `max(${right - left}%, 4px)` });
    input.value = get();
    output.textContent = good ? `${text(get())} \u2713` : text(get());
    output.classList.toggle("mlens-good", good);
    input.setAttribute("aria-valuetext", good ? `${text(get())}, within tolerance` : text(get()));
  };
  input.addEventListener("input", () => {
    set(Number(input.value));
    show();
  });
  show();
  return show;
}

const inMm = (value) => `${value.toFixed(1)} mm`, inDegrees = (value) => `${value.toFixed(0)}°`;

// The values of the pose around its home at which the picture loses less than 3 dB by this one alone.
function zoneOf(key, { pose, view }) {
  const limits = data.bears[key], home = homePose(view)[key], turns = key === "angle";
  if (limits === undefined) return null;
  const away = turns ? folded(pose[key] - home) : pose[key] - home;
  return { range: limits.map((limit) => limit + (turns ? folded(home) : home)), held: limits[0] <= away && away <= limits[1] };
}

class Controls {
  constructor(look, painter, motion) {
    [this.look, this.painter, this.motion] = [look, painter, motion];
    const ofPose = (key, label, low, high, text = inMm) => slider(part("sliders"), {
      label, low, high, step: 0.5, text, get: () => (key === "angle" ? folded(look.pose[key]) : look.pose[key]),
      set: (value) => look.move({ [key]: value }), bears: () => zoneOf(key, look),
    });
    const ofOrbit = (key, label, low, high, text) => slider(part("cuts"), { label, low, high, step: 1, text, get: () => look.orbit[key], set: (value) => look.turnAbout({ [key]: value }) });
    this.sliders = [
      ofPose("x", "Lens right", -lens.size, 1.45 * lens.size), ofPose("y", "Lens up", -1.4 * lens.size, lens.size),
      ofPose("angle", "Lens turned left", -180, 180, inDegrees), ofPose("lift", "Lens lifted", 0, 0.6 * lens.size),
      ofPose("eyeX", "Eye right", -0.75 * data.distance, 0.75 * data.distance), ofPose("eyeY", "Eye up", -0.75 * data.distance, 0.75 * data.distance),
      ofPose("eyeDistance", "Eye away", 0.4 * data.distance, 2 * data.distance),
      ofOrbit("cut", "Section", 0, 100, (value) => (value >= 100 ? "whole" : `at ${value} %`)), ofOrbit("cutAngle", "Direction of the section", 0, 180, inDegrees),
    ];
    this.#listViews();
  }

  // Everything beside the picture, as the look is now.
  show() {
    const { look } = this, atHome = look.checkHome(), chosen = part("views").querySelectorAll("input")[look.view];
    drawMarks(look);
    part("hint").textContent = hint(look);
    say(described(look, atHome));
    for (const each of this.sliders) each();
    if (chosen) chosen.checked = true;
    part("frames").value = look.view;
    part("frame").textContent = `Frame ${look.view + 1} of ${views.length}`;
  }

  choose(name) {
    const solid = name === "solid";
    this.look.tab = name;
    for (const other of ["table", "solid"]) {
      const button = document.getElementById(`mlens-tab-${other}`), chosen = other === name;
      button.setAttribute("aria-selected", chosen);
      button.tabIndex = chosen ? 0 : -1;
      document.getElementById(`mlens-panel-${other}`).hidden = !chosen;
    }
    part(solid ? "bench" : "stage").prepend(canvas);
    canvas.setAttribute("aria-label", solid ? "The lens as a solid" : "The table, seen from above: a source, and the lens upon it");
    canvas.setAttribute("aria-describedby", solid ? "mlens-solid-keys" : "mlens-keys");
    this.#stop();
    this.painter.fit();
    this.painter.touch(true);
  }

  #color() {
    const { orbit } = this.look, coloring = Number(root.querySelector('[name="mlens-colors"]:checked').value);
    orbit.coloring = coloring;
    part("legend").hidden = coloring === 0;
    part("most").textContent = coloring === 1 ? `${lens.steepest.toFixed(0)}°` : `${this.painter.solid.highestStep.toFixed(2)} mm`;
    this.painter.touch(true);
  }

  #stop() {
    this.motion.stop();
    part("play").setAttribute("aria-pressed", "false");
    part("play").textContent = "Play";
  }

  #play() {
    if (this.motion.plays) return this.#stop();
    this.motion.play();
    part("play").setAttribute("aria-pressed", "true");
    part("play").textContent = "Stop";
    return undefined;
  }

  #listViews() {
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
      input.addEventListener("change", () => this.motion.show(index));
      part("views").append(box);
    });
  }

  listen() {
    const { look, painter, motion } = this, on = (name, kind, work) => part(name).addEventListener(kind, work);
    on("home", "click", () => motion.glide(homePose(look.view)));
    on("aside", "click", () => motion.startAgain());
    on("link", "click", () => copyLink(look));
    on("play", "click", () => this.#play());
    on("frames", "input", (event) => {
      this.#stop();
      motion.show(Number(event.target.value), false);
    });
    on("turned", "click", () => {
      look.orbit = { ...startOrbit(), coloring: look.orbit.coloring };
      look.told(true);
    });
    for (const input of root.querySelectorAll('[name="mlens-colors"]')) input.addEventListener("change", () => this.#color());
    for (const input of root.querySelectorAll('[name="mlens-top"]')) input.addEventListener("change", () => painter.wear(Number(input.value)));
    for (const button of root.querySelectorAll('[role="tab"]')) this.#tab(button);
    addEventListener("hashchange", () => this.follow());
    dark.addEventListener("change", () => painter.touch(true));
    new ResizeObserver(() => {
      painter.fit();
      look.told(true);
    }).observe(stage);
  }

  #tab(button) {
    const name = button.id.replace("mlens-tab-", "");
    button.addEventListener("click", () => this.choose(name));
    button.addEventListener("keydown", (event) => {
      if (!["ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) return;
      const other = event.key === "Home" ? "table" : event.key === "End" ? "solid" : name === "table" ? "solid" : "table";
      this.choose(other);
      document.getElementById(`mlens-tab-${other}`).focus();
    });
  }

  // Goes to the pose that the address asks for; whether it asks for one.
  follow() {
    const asked = askedByAddress();
    if (!asked) return false;
    this.look.view = asked.view;
    this.painter.lay(asked.view);
    if (this.look.tab !== asked.tab) this.choose(asked.tab);
    this.look.move(asked.pose, true);
    return true;
  }
}
