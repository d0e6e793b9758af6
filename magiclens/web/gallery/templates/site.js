// The lens on the front page: a button lays it on the dots, then turns it. Without this script it shows its first view.
"use strict";
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
    state.textContent = at < 0 ? "Only dots, so far." : views[at].dataset.says + ".";
  }

  function step() {
    at = at + 1 < views.length ? at + 1 : -1;
    show();
  }

  button.hidden = false;
  button.addEventListener("click", step);
  show();
  if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) {
    window.setTimeout(function () { if (at < 0) { step(); } }, 1200);
  }
});
