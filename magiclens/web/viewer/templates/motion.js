// Motion without a hand: lens and eye glide to a pose, views follow one another as a film.

const GLIDE_MS = 600, FRAME_MS = 350;

class Motion {
  #gliding = 0;
  #playing = 0;

  constructor(look, painter) {
    [this.look, this.painter] = [look, painter];
  }

  get busy() {
    return Boolean(this.#gliding || this.#playing);
  }

  get plays() {
    return Boolean(this.#playing);
  }

  // Moves lens and eye to a pose, or at once if the user wants no motion.
  glide(to) {
    this.halt();
    if (reducedMotion.matches) return this.look.move(onTheWay(this.look.pose, to, 1));
    const from = { ...this.look.pose }, start = performance.now();
    const step = (now) => {
      const t = between((now - start) / GLIDE_MS, 0, 1);
      this.#gliding = t < 1 ? requestAnimationFrame(step) : 0;
      this.look.move(onTheWay(from, to, t));
    };
    this.#gliding = requestAnimationFrame(step);
    return undefined;
  }

  halt() {
    cancelAnimationFrame(this.#gliding);
    this.#gliding = 0;
  }

  show(view, moves = true) {
    this.look.view = view;
    this.painter.lay(view);
    if (moves) this.glide(homePose(view));
    else this.look.told(true);
  }

  startAgain() {
    this.look.forget();
    this.glide(asidePose(this.look.view));
  }

  play() {
    this.#playing = setInterval(() => this.show((this.look.view + 1) % views.length, false), FRAME_MS);
  }

  stop() {
    clearInterval(this.#playing);
    this.#playing = 0;
    this.painter.ask();
  }
}
