// The loop that draws. While something moves, slow machines draw fewer pixels; at rest the picture is refined.

// Without a move for IDLE_MS the picture is refined.
const IDLE_MS = 160;

class Painter {
  table = null;
  solid = null;
  busy = () => false; // whether a motion is under way after which there is more to draw
  progress = { pictures: 0, sharp: false }; // shown so far, and whether the last one had all pixels
  #top = null;
  #pace = null;
  #images = [];
  #laid = -1;
  #added = 0; // samples of the picture that is being refined, and the next row of the one that is being added
  #nextRow = 0;
  #lastMove = -1e9;
  #moved = false;
  #asked = 0;
  #waiting = [];

  constructor(look) {
    this.look = look;
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!this.gl) throw new Error("this browser offers no WebGL2.");
    if (!("DecompressionStream" in window)) throw new Error("this browser cannot unpack the lens; a current one can.");
  }

  async begin() {
    const top = (this.#top = await unpack(lens, data.tops[this.look.top]));
    this.#images = await Promise.all(data.sources.map(decoded));
    heightTexture(this.gl, top);
    this.#pace = paceOf(this.gl);
    this.solid = Object.assign(solidPicture(this.gl, lens, top), { highestStep: top.highestStep });
    this.table = tablePicture(this.gl, lens, top);
    this.#laid = -1;
    this.lay(this.look.view);
    this.fit();
    this.touch(true);
  }

  // Shows another top of the lens: as printed, or as designed.
  async wear(index) {
    this.look.top = index;
    Object.assign(this.#top, await unpack(lens, data.tops[index]));
    if (!this.table) return;
    heightTexture(this.gl, this.#top);
    this.solid.highestStep = this.#top.highestStep;
    this.touch(true);
  }

  // After the graphics were lost nothing is drawn until ``begin`` is called again.
  lose() {
    this.table = null;
  }

  // Lays the sheet of a view on the table.
  lay(view) {
    const { source } = views[view];
    if (!this.table || source === this.#laid) return;
    this.#laid = source;
    this.table.lay(this.#images[source]);
  }

  fit() {
    const holder = canvas.parentElement;
    Object.assign(canvas.style, { width: `${holder.clientWidth}px`, height: `${holder.clientHeight}px` });
  }

  touch(still = false) {
    this.#added = this.#nextRow = 0;
    if (!still) [this.#moved, this.#lastMove] = [true, performance.now()];
    this.ask();
  }

  ask() {
    if (!this.#asked) this.#asked = requestAnimationFrame((now) => this.#frame(now));
  }

  settled() {
    return new Promise((done) => {
      this.#waiting.push(done);
      this.ask();
    });
  }

  // The picture of the lens's square at the current pose, as the built-in tracer defines it: linear light, row by row.
  capture(size, samples = 3) {
    const { pose } = this.look, view = lensView(pose, lens, size), { wood, lost } = colors();
    for (let k = 0; k < samples * samples; k++) this.table.add(view, pose, { wood, lost, sheen: 0 }, k, samples, true);
    const light = this.table.light(size, size);
    this.touch(true);
    return light;
  }

  // A square picture of the sheet at any pose, so many mm wide, on a canvas of its own; ``fine`` if it is looked at for longer than a moment.
  // The page's canvas is spoiled until ``touch``.
  still(pose, view, size, mm, fine) {
    this.lay(view);
    const { wood, lost } = colors(), seen = tableView(pose, lens, size, size, mm / size, [0, 0]), samples = fine && this.table.most > 1 ? 2 : 1;
    for (let k = 0; k < samples * samples; k++) this.table.add(seen, pose, { wood, lost, sheen: sheen(pose, view) }, k, samples, false);
    resized(size, size);
    this.table.present(size, size);
    const copy = Object.assign(document.createElement("canvas"), { width: size, height: size });
    copy.getContext("2d", { willReadFrequently: true }).drawImage(canvas, 0, 0);
    return copy;
  }

  #frame(now) {
    this.#asked = 0;
    if (!this.table || this.gl.isContextLost() || !canvas.clientWidth) return;
    const moving = this.#moved || now - this.#lastMove < IDLE_MS; // a slow machine comes here long after the move
    if (!this.#pace.free(now) || (moving && !this.#moved)) return this.ask();
    if (this.look.tab === "solid" ? this.#drawSolid(now, moving) : this.#drawTable(now, moving)) this.#rest();
    else this.ask();
  }

  // Width and height of the next picture in pixels.
  #size(moving) {
    const all = pixels(1);
    return moving ? pixels(this.#pace.scale(all[0] * all[1])) : all;
  }

  #shown(now, [width, height], moving) {
    this.#pace.drawn(now, width * height, moving);
    Object.assign(this.progress, { pictures: this.progress.pictures + 1, sharp: width === pixels(1)[0] });
  }

  // Whether the picture is finished.
  #drawSolid(now, moving) {
    const [width, height] = this.#size(moving);
    resized(width, height);
    this.solid(this.look.orbit, width, height, colors(), views[this.look.view].rotation, this.table.sheet());
    this.#shown(now, [width, height], moving);
    this.#moved = false;
    return !moving;
  }

  // At rest slow machines draw some rows at a time, and stay ready for a move.
  #drawTable(now, moving) {
    if (!moving && this.#added >= this.table.most) return true; // another sample would count twice
    const [width, height] = this.#size(moving), { mm, w, middle } = region(), first = this.#nextRow, { pose, view } = this.look;
    const { wood, lost } = colors(), samples = moving || this.table.most === 1 ? 1 : SAMPLES;
    const rows = Math.min(moving ? height : this.#pace.rows(width, height), height - first);
    const seen = tableView(pose, lens, width, height, (mm * w) / width, middle);
    this.table.add(seen, pose, { wood, lost, sheen: sheen(pose, view) }, this.#added, samples, false, [first, rows]);
    this.#moved = false;
    this.#nextRow = (first + rows) % height;
    if (this.#nextRow) {
      this.#pace.drawn(now, width * rows, moving);
      return false;
    }
    resized(width, height);
    this.table.present(width, height);
    this.#shown(now, [width, rows], moving);
    this.#added = moving ? 0 : this.#added + 1;
    return !moving && this.#added >= this.table.most;
  }

  // The picture is finished: resolves the promises of ``settled``.
  #rest() {
    if (this.busy()) return;
    for (const done of this.#waiting) done();
    this.#waiting = [];
  }
}

async function decoded(uri) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  return image;
}

// Highlights are strong away from home, and faint there.
const sheen = (pose, view) => between(6 * awayFromHome(pose, view), 0.05, 1);

function pixels(scale) {
  const ratio = Math.min(devicePixelRatio || 1, 2) * scale;
  return [Math.max(Math.round(canvas.clientWidth * ratio), 1), Math.max(Math.round(canvas.clientHeight * ratio), 1)];
}

// The canvas gets as many pixels as the picture has; the browser stretches it.
function resized(width, height) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}
