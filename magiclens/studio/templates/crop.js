// The square of a picture that the lens shall show: a frame that is dragged, or moved and resized by sliders.
import { element } from "./server.js";

const dialog = document.getElementById("crop");
const stage = dialog.querySelector(".stage"), frame = dialog.querySelector(".frame"), picture = new Image();
const { side, across, down } = dialog.querySelector("form").elements;
// Smaller squares would show the lens their pixels.
const LEAST_PX = 64;

// Sliders count pixels of the picture, and keep themselves within the room that the others leave.
function draw() {
  const { naturalWidth: wide, naturalHeight: high } = picture;
  [across.max, down.max] = [wide - side.value, high - side.value];
  Object.assign(frame.style, { left: `${(100 * across.value) / wide}%`, top: `${(100 * down.value) / high}%`, width: `${(100 * side.value) / wide}%` });
  for (const slider of [side, across, down]) slider.previousElementSibling.textContent = `${slider.value} px`;
}

function drag(event) {
  const box = picture.getBoundingClientRect(), scale = picture.naturalWidth / box.width;
  const at = ({ clientX, clientY }) => [(clientX - box.left) * scale, (clientY - box.top) * scale];
  const [x, y] = at(event), resizes = event.target.closest(".corner");
  // where the frame is held; a press beside it takes it by its middle
  const held = event.target.closest(".frame") ? [x - across.value, y - down.value] : [side.value / 2, side.value / 2];
  const move = (moved) => {
    const [toX, toY] = at(moved);
    if (resizes) {
      const room = Math.min(picture.naturalWidth - across.value, picture.naturalHeight - down.value);
      side.value = Math.min(Math.max(toX - across.value, toY - down.value), room);
    } else [across.value, down.value] = [toX - held[0], toY - held[1]];
    draw();
  };
  event.preventDefault();
  stage.setPointerCapture(event.pointerId);
  stage.addEventListener("pointermove", move);
  stage.addEventListener("lostpointercapture", () => stage.removeEventListener("pointermove", move), { once: true });
  if (!resizes) move(event);
}

// The chosen square of a picture as a PNG file, or null.
export async function crop(name) {
  Object.assign(picture, { src: `/pictures/${name}`, alt: name });
  await picture.decode();
  stage.prepend(picture);
  const { naturalWidth: wide, naturalHeight: high } = picture, most = Math.min(wide, high);
  Object.assign(side, { min: Math.min(LEAST_PX, most), max: most, value: most });
  Object.assign(across, { max: wide - most, value: (wide - most) / 2 });
  Object.assign(down, { max: high - most, value: (high - most) / 2 });
  draw();
  dialog.returnValue = "";
  dialog.showModal();
  await new Promise((closed) => dialog.addEventListener("close", closed, { once: true }));
  if (dialog.returnValue !== "cut") return null;
  const [pixels, left, top] = [side, across, down].map((slider) => Number(slider.value));
  const canvas = element("canvas", { width: pixels, height: pixels });
  canvas.getContext("2d").drawImage(picture, left, top, pixels, pixels, 0, 0, pixels, pixels);
  return new Promise((made) => canvas.toBlob(made, "image/png"));
}

stage.addEventListener("pointerdown", drag);
dialog.addEventListener("input", draw);
