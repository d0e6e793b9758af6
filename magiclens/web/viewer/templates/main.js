// Start of the viewer, and ``window.magiclens`` for tests and for pages around the viewer.

function trouble(error) {
  root.querySelector(".mlens-plain").hidden = false;
  for (const panel of root.querySelectorAll('[role="tabpanel"]')) panel.hidden = true;
  root.querySelector(".mlens-tabs").hidden = true;
  part("trouble").textContent = `The lens cannot be moved about here: ${error.message} This is what it shows.`;
  const again = part("again"), story = part("story"), film = story.srcset;
  let times = 0;
  again.hidden = reducedMotion.matches;
  again.onclick = () => (story.srcset = `${film}#${++times}`); // another address: the film begins anew
}

async function open() {
  const look = new Look((still) => {
    controls.show();
    painter.touch(still);
  });
  const painter = new Painter(look), motion = new Motion(look, painter), controls = new Controls(look, painter, motion);
  painter.busy = () => motion.busy;
  window.magiclens = { ...window.magiclens, ...handles(look, painter, motion) };
  for (const each of [controls, new Hands(look, motion), new Projector(look, painter, motion)]) each.listen();
  part("share").addEventListener("click", () => shareFilm(painter));
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    painter.lose();
  });
  canvas.addEventListener("webglcontextrestored", () => painter.begin().catch(trouble));
  await painter.begin();
  root.querySelector(".mlens-plain").hidden = true;
  document.getElementById(`mlens-panel-${look.tab}`).hidden = false;
  painter.fit();
  if (!controls.follow()) look.move(asidePose(look.view), true);
}

function handles(look, painter, motion) {
  return {
    settled: () => painter.settled(), setPose: (change) => look.move(change), capture: (size, samples) => painter.capture(size, samples),
    show: (view, moves) => motion.show(view, moves), pose: () => ({ ...look.pose }), view: () => look.view, views: views.map((view) => view.name),
    atHome: () => look.checkHome(), progress: () => ({ ...painter.progress }),
    // the square of the lens at home, in CSS pixels of the window
    square: () => {
      const box = canvas.getBoundingClientRect(), h = lens.size / 2;
      const [[left, top], [right, bottom]] = [toScreen([-h, h]), toScreen([h, -h])];
      return { x: box.left + left, y: box.top + top, width: right - left, height: bottom - top };
    },
  };
}

const ready = open();
window.magiclens = { ...window.magiclens, ready };
ready.catch(trouble);
