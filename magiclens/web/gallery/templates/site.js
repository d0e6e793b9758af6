// The lens on the front page: a button lays it on the dots, then turns it. Without this script it shows its first view.
"use strict";
var still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;

// The picture snaps together: facets show patches of the dots, then one after another their tiles of the picture.
function snap(lens, dots, view, wait) {
  var n = 24, long = 900, old = lens.querySelector("canvas"), canvas = document.createElement("canvas");
  if (old) { old.remove(); }
  var side = canvas.width = canvas.height = 480, tile = side / n, context = canvas.getContext("2d");
  var late = Array.from({ length: n * n }, function () { return Math.random(); });
  canvas.setAttribute("aria-hidden", "true");
  context.drawImage(dots, 0, 0, side, side);
  lens.insertBefore(canvas, lens.querySelector(".corner"));
  var from = view.naturalWidth / n, begun = performance.now() + wait;

  function frame(now) {
    var t = (now - begun) / long;
    late.forEach(function (wanted, k) {
      var p = Math.min(Math.max((t - 0.7 * wanted) / 0.3, 0), 1), x = k % n, y = Math.floor(k / n);
      if (!p) { return; }
      var away = (1 - p) * (1 - p) * 3 * (wanted - 0.5), column = Math.min(Math.max(x + away, 0), n - 1);
      context.drawImage(view, column * from, y * from, from, from, x * tile, y * tile, tile + 0.5, tile + 0.5);
    });
    if (t < 1) { window.requestAnimationFrame(frame); } else { canvas.remove(); }
  }

  window.requestAnimationFrame(frame);
}

document.querySelectorAll("[data-try]").forEach(function (figure) {
  var lens = figure.querySelector("[data-lens]");
  var button = figure.querySelector("[data-turn]");
  var state = figure.querySelector("[data-state]");
  var views = Array.prototype.slice.call(lens.querySelectorAll("img"));
  var at = -1, angle = 0;

  function show() {
    var turn = at < 0 ? null : /lens at (-?[\d.]+)/.exec(views[at].dataset.says);
    var wanted = turn ? Number(turn[1]) : 0;
    angle += ((wanted - angle) % 360 + 360) % 360;
    lens.classList.toggle("away", at < 0);
    lens.style.setProperty("--turn", -angle + "deg");
    views.forEach(function (view, k) { view.hidden = k !== Math.max(at, 0); });
    button.textContent = at < 0 ? "Lay the lens on the dots" : at + 1 < views.length ? "Turn the lens" : "Take it away";
    if (at >= 0 && !still) { snap(lens, figure.querySelector(".table > img"), views[at], at ? 0 : 500); }
    state.textContent = at < 0 ? "Only dots, so far." : views[at].dataset.says + ".";
  }

  function step() {
    at = at + 1 < views.length ? at + 1 : -1;
    show();
  }

  button.hidden = false;
  button.addEventListener("click", step);
  show();
  if (!still) {
    window.setTimeout(function () { if (at < 0) { step(); } }, 1200);
  }
});
