// Projector mode: nothing but the table, as large as the screen, and keys as presenters have them.

class Projector {
  constructor(look, painter, motion) {
    [this.look, this.painter, this.motion] = [look, painter, motion];
  }

  listen() {
    part("project").addEventListener("click", () => this.#begin());
    part("onward").addEventListener("click", () => this.#onward());
    part("leave").addEventListener("click", () => this.#end());
    // the browser leaves the full screen by itself when Escape is pressed there
    document.addEventListener("fullscreenchange", () => document.fullscreenElement || this.#end());
    root.addEventListener("keydown", (event) => {
      if (!this.#on || !["Escape", "PageDown", "PageUp"].includes(event.key)) return;
      event.preventDefault();
      if (event.key === "Escape") this.#end();
      else if (event.key === "PageDown") this.#onward();
      else this.#restart();
    });
  }

  get #on() {
    return root.classList.contains("mlens-projected");
  }

  #begin() {
    root.classList.add("mlens-projected");
    document.documentElement.classList.add("mlens-behind");
    root.requestFullscreen?.().catch(() => {}); // where that is not allowed, the page is filled
    part("bar").hidden = false;
    this.#restart();
    canvas.focus();
    this.painter.touch(true);
  }

  #end() {
    if (!this.#on) return;
    root.classList.remove("mlens-projected");
    document.documentElement.classList.remove("mlens-behind");
    part("bar").hidden = true;
    if (document.fullscreenElement) document.exitFullscreen();
    part("project").focus();
    this.painter.touch(true);
  }

  // The lens is laid in place; then one view follows the other, and at last all begins again.
  #onward() {
    const next = this.look.found ? this.look.view + 1 : this.look.view;
    if (next < views.length) this.motion.show(next);
    else this.#restart();
  }

  #restart() {
    this.look.view = 0;
    this.painter.lay(0);
    this.motion.startAgain();
  }
}
