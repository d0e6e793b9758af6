// Pictures and the form: what the user wants.
import { crop } from "./crop.js";
import { foresee, preview } from "./preview.js";
import { ask, complain, element, noComplaint, say } from "./server.js";

const form = document.getElementById("order");
const list = document.getElementById("pictures");
const written = document.getElementById("written");
const yaml = document.getElementById("yaml");
let names = [];
let chosen = [];

export function showPictures(found) {
  if (JSON.stringify(found) === JSON.stringify(names)) return;
  names = found;
  chosen = chosen.filter((name) => names.includes(name));
  draw();
}

function draw() {
  const focus = document.activeElement?.id;
  list.replaceChildren(...names.map(item));
  if (focus) document.getElementById(focus)?.focus();
  guess();
}

// How values of the sliders are called; 0 leaves facets and thickness to the machine.
const USUAL = "usual";
const SAID = {
  size: (value) => `${value} mm`, facets: (value) => (value ? `${value} x ${value}` : USUAL),
  thickness: (value) => (value ? `${value} mm` : USUAL), contrast: (value) => (value ? `${value} % of tones cut` : "as they are"),
};
const PAUSE_MS = 250;
let soon = 0;

// What the page shows of the order follows every change, a moment later.
function guess() {
  for (const [name, text] of Object.entries(SAID)) {
    const input = form.elements[name];
    input.previousElementSibling.textContent = text(Number(input.value));
    input.setAttribute("aria-valuetext", text(Number(input.value)));
  }
  clearTimeout(soon);
  soon = setTimeout(async () => {
    try {
      const made = order(), lens = await foresee(made);
      if (lens) await preview(made, lens);
    } catch (error) {
      preview(null);
      foresee(null, error);
    }
  }, PAUSE_MS);
}

function item(name) {
  const box = element("input", { type: "checkbox", id: `choose-${name}`, checked: chosen.includes(name) });
  box.addEventListener("change", () => {
    chosen = box.checked ? [...chosen, name] : chosen.filter((other) => other !== name);
    draw();
  });
  const remove = element("button", { type: "button", id: `delete-${name}`, ariaLabel: `Delete ${name}` }, "Delete");
  remove.addEventListener("click", () => trying(() => ask("DELETE", `/api/pictures/${name}`)));
  const cut = element("button", { type: "button", id: `crop-${name}`, ariaLabel: `Crop ${name}` }, "Crop");
  cut.addEventListener("click", () => trying(() => cutOut(name)));
  const place = chosen.includes(name) ? ` (${chosen.indexOf(name) + 1})` : "";
  const picture = element("img", { src: `/pictures/${name}`, alt: "", loading: "lazy" });
  return element("li", {}, element("label", {}, picture, box, ` ${name}${place}`), element("div", { className: "acts" }, cut, remove));
}

// A square of a picture takes its place; the picture stays.
async function cutOut(name) {
  const square = await crop(name);
  if (!square) return;
  const made = await kept(`${name.replace(/\.\w+$/, "")}-cropped.png`, square);
  const place = chosen.indexOf(name);
  chosen = chosen.filter((other) => other !== made);
  if (place < 0) chosen.push(made);
  else chosen = chosen.map((other) => (other === name ? made : other));
  say(`${made} is added`);
  draw();
}

// The name by which the studio keeps a picture.
async function kept(name, file) {
  const answer = await ask("POST", `/api/pictures?name=${encodeURIComponent(name)}`, file);
  if (!names.includes(answer.name)) names = [...names, answer.name].sort();
  return answer.name;
}

async function trying(work) {
  noComplaint();
  try {
    return await work();
  } catch (error) {
    complain(error);
    return undefined;
  }
}

async function add(files) {
  noComplaint();
  for (const file of files) {
    say(`Adding ${file.name}`);
    try {
      const name = await kept(file.name, file);
      if (!chosen.includes(name)) chosen.push(name);
      say(`${name} is added`);
    } catch (error) {
      say(`${file.name} is refused`);
      complain(error);
    }
  }
  draw();
}

function order() {
  const values = new FormData(form);
  const radio = form.querySelector("[name=scenario]:checked");
  const [least, most] = [Number(radio.dataset.least), Number(radio.dataset.most)];
  if (chosen.length < least || chosen.length > most) {
    const many = least === most ? "one picture" : `${least} to ${most} pictures`;
    throw `Choose ${many} above; ${chosen.length} chosen now.`;
  }
  const number = (name) => Number(values.get(name));
  return {
    scenario: radio.value, pictures: chosen, machine: values.get("machine") || null, size: `${number("size")}mm`, facets: number("facets") || null,
    thickness: number("thickness") ? `${number("thickness")}mm` : null, paper: values.get("paper"), jig: values.has("jig"), crop: values.get("crop"), ground: values.get("ground"), contrast: number("contrast") / 100,
  };
}

async function queue(made) {
  say("Checking");
  const done = await trying(async () => ask("POST", "/api/jobs", made()));
  say(done ? "The draft is queued" : "That cannot be designed: see the errors below the form");
  if (done) document.getElementById("h-jobs").scrollIntoView({ block: "nearest" }); // on a phone it is far below
}

async function copy() {
  await trying(async () => {
    const spec = await ask("POST", "/api/specs", order());
    open(spec.yaml);
    yaml.select();
    try {
      await navigator.clipboard.writeText(spec.yaml);
      say("The YAML is copied");
    } catch {
      say("The YAML is selected: copy it with Ctrl-C");
    }
  });
}

function open(text) {
  yaml.value = text;
  written.hidden = false;
  yaml.focus();
}

// Longer motion would need a button to stop it, and keeps machines without a GPU busy. A card that is pointed at moves on.
const MOVING_MS = 4800;

function moveCards() {
  const cards = form.querySelector(".cards");
  cards.classList.add("moving");
  setTimeout(() => cards.classList.remove("moving"), MOVING_MS);
}

export function listen() {
  moveCards();
  const drop = document.getElementById("drop");
  for (const files of [document.getElementById("files"), document.getElementById("camera")]) {
    files.addEventListener("change", async () => {
      await add([...files.files]);
      files.value = "";
    });
  }
  for (const kind of ["dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      event.preventDefault();
      drop.classList.toggle("over", kind === "dragover");
      if (kind === "drop") add([...event.dataTransfer.files]);
    });
  }
  document.addEventListener("paste", (event) => {
    const pasted = [...event.clipboardData.files];
    if (pasted.length) add(pasted);
  });
  form.addEventListener("input", (event) => event.target.name && guess());
  guess();
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    queue(order);
  });
  document.getElementById("copy").addEventListener("click", copy);
  const opened = document.getElementById("open");
  opened.addEventListener("change", async () => {
    open(await opened.files[0].text());
    opened.value = "";
  });
  document.getElementById("run-yaml").addEventListener("click", () => queue(() => ({ yaml: yaml.value })));
  document.getElementById("close").addEventListener("click", () => {
    written.hidden = true;
    document.getElementById("copy").focus();
  });
}
