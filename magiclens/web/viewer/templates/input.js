// Pointer and keyboard.

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const WASD = { a: [-1, 0], d: [1, 0], w: [0, 1], s: [0, -1] };
const mover = () => root.querySelector('[name="mlens-mover"]:checked').value;

class Hands {
  #held = new Map(); // where each finger, or the mouse, is now
  #grip = null; // what they move, and how all was when they took it

  constructor(look, motion) {
    [this.look, this.motion] = [look, motion];
  }

  listen() {
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.#release(event));
    // a finger that holds the lens does not scroll the page; a finger on the bare table does
    canvas.addEventListener("touchstart", (event) => {
      const [finger] = event.changedTouches;
      if (this.look.tab === "solid" || this.#grip || mover() === "eye" || onLens(this.look.pose, fromEvent(finger))) event.preventDefault();
    }, { passive: false });
    canvas.addEventListener("touchmove", (event) => this.#grip && event.preventDefault(), { passive: false });
    rim.querySelector(".mlens-handle").addEventListener("pointerdown", (event) => {
      event.preventDefault();
      this.#held.set(event.pointerId, { at: fromEvent(event) });
      this.#grab("turn");
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  #grab(kind) {
    this.#grip = { kind, start: [...this.#held.values()].map((p) => p.at), raw: { ...this.look.pose }, orbit: { ...this.look.orbit } };
  }

  #press(event) {
    if (event.button) return;
    this.motion.halt();
    const at = fromEvent(event), touching = event.pointerType === "touch", solid = this.look.tab === "solid";
    const kind = solid ? "orbit" : mover() === "eye" ? "eye" : onLens(this.look.pose, at) ? "lens" : touching ? null : "eye";
    this.#held.set(event.pointerId, { at });
    if (this.#held.size === 2 && this.#grip) this.#grab(solid ? "near" : "twist");
    else if (kind) this.#grab(kind);
    else return this.#held.delete(event.pointerId);
    canvas.setPointerCapture(event.pointerId);
    canvas.classList.add("mlens-held");
    return true;
  }

  #drag(event) {
    if (!this.#held.has(event.pointerId) || !this.#grip) return;
    this.#held.get(event.pointerId).at = fromEvent(event);
    const now = [...this.#held.values()].map((p) => p.at), { kind, start, raw, orbit } = this.#grip, [[x0, y0]] = start, [[x, y]] = now;
    if (kind === "lens") {
      const scale = (raw.eyeDistance - raw.lift) / raw.eyeDistance;
      this.#settle({ ...raw, x: raw.x + (x - x0) * scale, y: raw.y + (y - y0) * scale });
    } else if (kind === "turn") {
      const [cx, cy] = seenAt(raw, [0, 0]);
      this.#settle({ ...raw, angle: raw.angle + ((Math.atan2(y - cy, x - cx) - Math.atan2(y0 - cy, x0 - cx)) * 180) / Math.PI });
    } else if (kind === "eye") {
      this.look.move({ eyeX: raw.eyeX + 3 * (x - x0), eyeY: raw.eyeY + 3 * (y - y0) });
    } else if (kind === "orbit") {
      const { mm } = region();
      this.look.turnAbout({ around: orbit.around - (0.5 * (x - x0)) / mm, above: orbit.above - (0.4 * (y - y0)) / mm });
    } else this.#pinch(now);
  }

  // Two fingers turn and lift the lens, or bring the solid nearer.
  #pinch(now) {
    const { kind, start, raw, orbit } = this.#grip;
    if (now.length < 2 || start.length < 2) return;
    const across = ([a, b]) => [b[0] - a[0], b[1] - a[1]], [before, after] = [across(start), across(now)];
    const ratio = Math.hypot(...after) / Math.max(Math.hypot(...before), 1);
    if (kind === "near") return this.look.turnAbout({ far: orbit.far / Math.max(ratio, 0.1) });
    const turn = ((Math.atan2(after[1], after[0]) - Math.atan2(before[1], before[0])) * 180) / Math.PI;
    this.#settle({ ...raw, angle: raw.angle + folded(turn), lift: raw.lift + (ratio - 1) * 0.4 * lens.size });
  }

  #settle(raw) {
    this.look.settle(raw, NEAR, NEAR_ANGLE, NEAR_LIFT);
  }

  #release(event) {
    if (!this.#held.delete(event.pointerId)) return;
    this.#grip = null;
    if (!this.#held.size) canvas.classList.remove("mlens-held");
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (this.look.tab === "solid" ? this.#keyOfSolid(event) : this.#keyOfTable(event)) event.preventDefault();
  }

  // Whether the key means something here.
  #keyOfTable(event) {
    const key = event.key.toLowerCase(), big = event.shiftKey ? 5 : 1, arrow = ARROWS[event.key], eye = WASD[key] || (mover() === "eye" && arrow);
    const { pose } = this.look;
    this.motion.halt();
    if (eye) this.look.move({ eyeX: pose.eyeX + 5 * big * eye[0], eyeY: pose.eyeY + 5 * big * eye[1] });
    else if (arrow) this.#nudge({ x: pose.x + big * arrow[0], y: pose.y + big * arrow[1] });
    else if (key === "q" || key === "e") this.#nudge({ angle: pose.angle + (key === "q" ? big : -big) });
    else if ("+=-_".includes(key)) this.#nudge({ lift: Math.max(pose.lift + ("+=".includes(key) ? big : -big), 0) });
    else if (key === "enter") this.motion.glide(homePose(this.look.view));
    else if (key === "r" || key === "home") this.motion.startAgain();
    else return false;
    return true;
  }

  // A step of the keyboard snaps into a home only if it comes nearer; otherwise the lens could never leave.
  #nudge(change) {
    const { pose, view } = this.look, next = { ...pose, ...change };
    if (awayFromHome(next, view) < awayFromHome(pose, view)) return this.look.settle(next, 1.5, 3, 1.5);
    return this.look.move(next);
  }

  #keyOfSolid(event) {
    const { orbit } = this.look, arrow = ARROWS[event.key], big = event.shiftKey ? 15 : 5;
    if (arrow) this.look.turnAbout({ around: orbit.around - big * arrow[0], above: orbit.above - big * arrow[1] });
    else if ("+=".includes(event.key)) this.look.turnAbout({ far: orbit.far / 1.1 });
    else if ("-_".includes(event.key)) this.look.turnAbout({ far: orbit.far * 1.1 });
    else return false;
    return true;
  }
}
