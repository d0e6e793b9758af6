// Shows the sources of a run at their true size. Lengths are mm, or CSS pixels, or pixels of the screen: "dots".
(() => {
"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
const KEY = "magiclens: dots per mm"; // which zooming a page does not change
const USUAL = 96 / 25.4; // CSS pixels per mm
const part = (id) => document.getElementById(id);
const stage = part("stage"), canvas = stage.querySelector("canvas"), calibration = part("calibration");
const pictures = new Map();
let shown = 0, dotsPerMm = stored() || USUAL * devicePixelRatio, calibrated = Boolean(stored()), outlined = true, drawn = null;

function stored() {
  try { return Number(localStorage.getItem(KEY)) || 0; } catch { return 0; } // some browsers forbid it for files
}

const perMm = () => dotsPerMm / devicePixelRatio;

function keep() {
  try { localStorage.setItem(KEY, String(dotsPerMm)); } catch { /* it is asked for again next time */ }
}

const LINEAR = Float32Array.from({ length: 256 }, (_, k) => {
  const v = k / 255;
  return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
});
const toDisplay = (v) => 255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);

// The sources in linear light, three channels, rows from the top.
async function load(index) {
  if (!pictures.has(index)) {
    const image = new Image();
    image.src = DATA.frames[index].picture;
    await image.decode();
    const { naturalWidth: width, naturalHeight: height } = image;
    const pad = Object.assign(document.createElement("canvas"), { width, height }).getContext("2d", { willReadFrequently: true });
    pad.drawImage(image, 0, 0);
    const bytes = pad.getImageData(0, 0, width, height).data, light = new Float32Array(3 * width * height);
    for (let k = 0, n = width * height; k < n; k++) {
      for (let c = 0; c < 3; c++) light[3 * k + c] = LINEAR[bytes[4 * k + c]];
    }
    pictures.clear(); // one is enough: films have many, and a phone little memory
    pictures.set(index, { light, width, height });
  }
  return pictures.get(index);
}

// Exact means over areas along rows, for a picture (height, width, 3), with rows and columns exchanged in the result.
function shrink(light, width, height, dots) {
  const out = new Float32Array(3 * dots * height), step = width / dots;
  for (let i = 0; i < height; i++) {
    for (let j = 0; j < dots; j++) {
      const from = j * step, to = Math.min((j + 1) * step, width), last = Math.min(Math.ceil(to), width);
      const sum = [0, 0, 0];
      for (let k = Math.floor(from); k < last; k++) {
        const share = (Math.min(k + 1, to) - Math.max(k, from)) / step;
        for (let c = 0; c < 3; c++) sum[c] += share * light[3 * (i * width + k) + c];
      }
      for (let c = 0; c < 3; c++) out[3 * (j * height + i) + c] = sum[c];
    }
  }
  return out;
}

async function paint() {
  const ratio = devicePixelRatio, dots = Math.max(1, Math.round(DATA.size * dotsPerMm)), frame = shown;
  const wanted = `${frame} ${dots}`;
  if (drawn !== wanted) {
    const { light, width, height } = await load(frame);
    if (frame !== shown) return;
    const across = shrink(light, width, height, dots), both = shrink(across, height, dots, dots);
    canvas.width = canvas.height = dots;
    const context = canvas.getContext("2d"), image = context.createImageData(dots, dots);
    for (let k = 0; k < dots * dots; k++) {
      for (let c = 0; c < 3; c++) image.data[4 * k + c] = Math.round(toDisplay(both[3 * k + c]));
      image.data[4 * k + 3] = 255;
    }
    context.putImageData(image, 0, 0);
    drawn = wanted;
  }
  place(dots / ratio, ratio);
}

// Put the sheet in the middle of the stage, on whole dots of the screen, and the outlines about it.
function place(side, ratio) {
  const box = stage.getBoundingClientRect();
  const snap = (at, origin) => Math.round((at + origin) * ratio) / ratio - origin;
  const left = snap((box.width - side) / 2, box.left), top = snap((box.height - side) / 2, box.top);
  Object.assign(canvas.style, { left: `${left}px`, top: `${top}px`, width: `${side}px`, height: `${side}px` });
  stage.querySelectorAll(".outline, .up").forEach((old) => old.remove());
  if (outlined) DATA.frames[shown].outlines.forEach((o) => outline(o, left + side / 2, top + side / 2));
  say(box, side);
}

function outline([west, south, east, north], x, y) {
  const edges = { left: x + west * perMm(), right: x + east * perMm(), top: y - north * perMm(), bottom: y - south * perMm() };
  const frame = Object.assign(document.createElement("div"), { className: "outline" });
  const { left, right, top, bottom } = edges;
  Object.assign(frame.style, { left: `${left}px`, top: `${top}px`, width: `${right - left}px`, height: `${bottom - top}px` });
  stage.append(frame);
  for (const [edge, text] of Object.entries(DATA.frames[shown].up)) {
    const label = Object.assign(document.createElement("div"), { className: "up", textContent: `\u25B2 ${text}` });
    const turn = { top: 0, right: 90, bottom: 180, left: 270 }[edge], along = edge === "top" || edge === "bottom";
    Object.assign(label.style, {
      left: `${along ? (left + right) / 2 : edges[edge] + (edge === "left" ? -10 : 10)}px`,
      top: `${along ? edges[edge] + (edge === "top" ? -10 : 10) : (top + bottom) / 2}px`,
      transform: `translate(-50%, -50%) rotate(${turn}deg)`,
    });
    stage.append(label);
  }
}

function say(box, side) {
  const frame = DATA.frames[shown], many = DATA.frames.length;
  const words = [many > 1 ? `${frame.name} (${shown + 1} of ${many}).` : `${frame.name}.`];
  if (!calibrated) words.push("The size is a guess: set it with a bank card.");
  if (side > box.width || side > box.height) {
    const seen = [box.width, box.height].map((length) => Math.floor(length / perMm())).join(" x ");
    words.push(`The sheet is ${DATA.size} mm wide, but this screen shows only ${seen} mm of it.`);
  }
  words.push("Lay the lens on the outline. ", frame.views.slice(0, 8).join("; "));
  part("words").textContent = words.join(" ");
  stage.setAttribute("aria-label", `The sheet ${frame.name}, ${DATA.size} mm wide`);
}

function step(by) {
  shown = (shown + by + DATA.frames.length) % DATA.frames.length;
  return paint();
}

function openCalibration(open) {
  calibration.hidden = !open;
  if (!open) return;
  part("scale").value = perMm();
  drawCard();
  part("scale").focus();
}

function drawCard() {
  const [width, height] = DATA.card;
  Object.assign(part("card").style, { width: `${width * perMm()}px`, height: `${height * perMm()}px` });
}

function rescale() {
  dotsPerMm = Number(part("scale").value) * devicePixelRatio;
  calibrated = true;
  drawCard();
}

function done() {
  openCalibration(false);
  calibrated = true;
  keep();
  stage.focus();
  return paint();
}

function toggleLines() {
  outlined = !outlined;
  part("lines").setAttribute("aria-pressed", String(outlined));
  return paint();
}

function toggleFull() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen();
}

const ACTIONS = {
  ArrowRight: () => step(1), ArrowLeft: () => step(-1), " ": () => step(1), c: () => openCalibration(calibration.hidden),
  o: toggleLines, f: toggleFull,
};
addEventListener("keydown", (event) => {
  if (!calibration.hidden) {
    if (event.key === "Escape" || event.key === "Enter") done();
    return;
  }
  const pressing = event.target.tagName === "BUTTON" && event.key === " "; // which presses the button
  if (!ACTIONS[event.key] || pressing || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  ACTIONS[event.key]();
});
part("previous").onclick = () => step(-1);
part("next").onclick = () => step(1);
part("calibrate").onclick = () => openCalibration(calibration.hidden);
part("lines").onclick = toggleLines;
part("full").onclick = toggleFull;
part("scale").oninput = rescale;
part("done").onclick = done;
stage.onclick = () => step(1);
part("full").hidden = !document.fullscreenEnabled; // not on all phones
part("previous").hidden = part("next").hidden = DATA.frames.length < 2;
addEventListener("resize", paint);
openCalibration(!calibrated);
window.magiclens = { ready: paint() };
})();
