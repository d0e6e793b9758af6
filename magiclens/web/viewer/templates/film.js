// A film to share: the lens glides onto the sheet, and from view to view. MP4 where the browser encodes video, else a GIF.

const FILM_PX = 480, FPS = 12, MOST_VIEWS = 4;
const GLIDE_FRAMES = 14, TURN_FRAMES = 8, HOLD_FRAMES = 16;

// Poses of a film with their views, and how many frames each of them is shown.
function filmPoses() {
  const many = Math.min(views.length, MOST_VIEWS), film = [];
  const all = Array.from({ length: many }, (_, k) => (many > 1 ? Math.round((k * (views.length - 1)) / (many - 1)) : 0));
  const way = (from, to, view, most) => {
    const steps = Object.keys(from).every((key) => from[key] === to[key]) ? 1 : most;
    for (let k = 1; k <= steps; k++) film.push({ pose: onTheWay(from, to, k / steps), view, frames: k < steps ? 1 : HOLD_FRAMES });
  };
  const aside = { ...asidePose(0), x: 1.35 * lens.size, y: 0 };
  film.push({ pose: aside, view: 0, frames: HOLD_FRAMES / 2 });
  way(aside, homePose(0), 0, GLIDE_FRAMES);
  for (let k = 1; k < many; k++) way(homePose(all[k - 1]), homePose(all[k]), all[k], TURN_FRAMES);
  return film;
}

const pause = () => new Promise((done) => setTimeout(done));

// The pictures of the film, each on a canvas. Between them the page stays alive.
async function filmed(painter, said) {
  const film = filmPoses(), mm = 2.2 * Math.min(SHEET, 0.7) * lens.size;
  stage.classList.add("mlens-filming");
  try {
    for (const [k, frame] of film.entries()) {
      frame.picture = painter.still(frame.pose, frame.view, FILM_PX, mm, frame.frames > 1);
      said(`The film is being made: ${Math.round((100 * (k + 1)) / film.length)} %`);
      await pause();
    }
  } finally {
    stage.classList.remove("mlens-filming");
    painter.lay(painter.look.view);
    painter.touch(true);
  }
  return film;
}

async function filmFile(painter, said) {
  const film = await filmed(painter, said);
  said("The film is being written");
  await pause();
  const video = await mp4(film, FILM_PX, FPS);
  if (video) return { name: "magic-lens.mp4", content: video };
  return { name: "magic-lens.gif", content: gif(film.map(({ picture, frames }) => ({ picture, hold: frames / FPS })), FILM_PX) };
}

// Hands the film to the share sheet of a phone, or downloads it.
async function shareFilm(painter) {
  const button = part("share");
  button.disabled = true;
  try {
    const { name, content } = await filmFile(painter, (text) => (part("hint").textContent = text));
    const file = new File([content], name, { type: content.type }), shares = matchMedia("(pointer: coarse)").matches && navigator.canShare?.({ files: [file] });
    if (!shares || !(await navigator.share({ files: [file] }).then(() => true, (error) => error.name === "AbortError"))) save(file);
    say(`The film is ready: ${name}, ${(content.size / 1e6).toFixed(1)} MB.`);
  } catch (error) {
    say(`No film: ${error.message}`);
  } finally {
    part("hint").textContent = hint(painter.look);
    button.disabled = false;
    button.focus();
  }
}

function save(file) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: file.name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
