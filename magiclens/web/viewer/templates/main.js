// Start of the viewer, and ``window.magiclens`` for tests and for pages around the viewer.

async function decoded(uri) {
  const image = new Image();
  image.src = uri;
  await image.decode();
  return image;
}

async function begin() {
  const top = await unpack(lens);
  images = await Promise.all(data.sources.map(decoded));
  heightTexture(gl, top);
  pace = paceOf(gl);
  solid = Object.assign(solidPicture(gl, lens, top), { highestStep: top.highestStep });
  table = tablePicture(gl, lens, top);
  table.lay(images[views[current].source]);
  root.querySelector(".mlens-plain").hidden = true;
  document.getElementById(`mlens-panel-${tab}`).hidden = false;
  fit();
  touch(true);
}

function trouble(error) {
  root.querySelector(".mlens-plain").hidden = false;
  for (const panel of root.querySelectorAll('[role="tabpanel"]')) panel.hidden = true;
  root.querySelector(".mlens-tabs").hidden = true;
  part("trouble").textContent = `The lens cannot be moved about here: ${error.message} This is what it shows in its place.`;
}

async function open() {
  gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
  if (!gl) throw new Error("this browser offers no WebGL2.");
  if (!("DecompressionStream" in window)) throw new Error("this browser cannot unpack the lens; a current one can.");
  listViews();
  addListeners();
  await begin();
  if (followAddress()) return;
  pose = clamped(asidePose());
  refresh(true);
}

const settled = () => new Promise((done) => {
  waiting.push(done);
  ask();
});

// The picture of the lens's square at the current pose, as the built-in tracer defines it: linear light, row by row.
function capture(size, samples = 3) {
  const view = lensView(pose, lens, size), { wood, lost } = colors();
  for (let k = 0; k < samples * samples; k++) table.add(view, pose, { wood, lost, sheen: 0 }, k, samples, true);
  const light = table.light(size, size);
  touch(true);
  return light;
}

const ready = open();
ready.catch(trouble);
window.magiclens = {
  ready, settled, setPose, capture, show, pose: () => ({ ...pose }), view: () => current, views: views.map((view) => view.name),
  atHome: () => checkHome(), progress: () => ({ ...progress }),
  // the square of the lens at home, in CSS pixels of the window
  square: () => {
    const box = canvas.getBoundingClientRect(), h = lens.size / 2;
    const [[left, top], [right, bottom]] = [toScreen([-h, h]), toScreen([h, -h])];
    return { x: box.left + left, y: box.top + top, width: right - left, height: bottom - top };
  },
};
