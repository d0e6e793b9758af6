// The list of jobs: state, progress, results. What has not changed is left alone, so that focus and reading stay.
import { ask, complain, duration, element, noComplaint, room, say } from "./server.js";

const list = document.getElementById("jobs");
const nothing = list.firstElementChild;
const shown = new Map();
const TITLES = { draft: "Draft", full: "Full design" };
const VIEWER = "view.html";
const PAGES = { [VIEWER]: "The viewer on a page of its own", "show.html": "Show the sheet on a screen", "report.html": "Report", "preflight.html": "Preflight" };
const MAIN_FILES = 3;
const TICK_MS = 1000;

setInterval(() => {
  for (const clock of list.querySelectorAll("[data-began]")) clock.textContent = duration(Date.now() / 1000 - clock.dataset.began);
}, TICK_MS);

const forget = document.getElementById("forget");
forget.addEventListener("click", () => trying(() => ask("DELETE", "/api/results").then(() => say("Kept results are cleared"))));

async function trying(work) {
  noComplaint();
  try {
    await work();
  } catch (error) {
    complain(error);
  }
}

export function showJobs(jobs, bytes, kept) {
  document.getElementById("room").textContent = `${room(bytes)} on the disk, ${room(kept)} of it results kept for later runs.`;
  const there = new Set(jobs.map((job) => job.id));
  for (const [id, known] of shown) {
    if (!there.has(id)) {
      known.box.remove();
      shown.delete(id);
    }
  }
  if (!jobs.length) list.replaceChildren(nothing);
  else nothing.remove();
  jobs.toReversed().forEach((job) => show(job));
}

function show(job) {
  if (!shown.has(job.id)) {
    const [head, results] = [element("div"), element("div")];
    const box = element("article", { className: "job panel", id: `job-${job.id}` }, head, results);
    shown.set(job.id, { box, head, results, job: null });
    list.prepend(box);
  }
  const known = shown.get(job.id);
  const before = known.job;
  known.job = job;
  if (before && before.state !== job.state) say(`${job.title}: ${words(job)}`);
  if (JSON.stringify(before) !== JSON.stringify(job)) refill(known.head, head(job));
  if (JSON.stringify(before?.runs) !== JSON.stringify(job.runs)) refill(known.results, results(job));
}

function refill(box, children) {
  const focus = box.contains(document.activeElement) ? document.activeElement.dataset.key : null;
  box.replaceChildren(...children);
  if (focus) (box.querySelector(`[data-key="${focus}"]`) ?? box.querySelector("button, a"))?.focus();
}

function words(job) {
  const what = TITLES[job.want].toLowerCase();
  return { waiting: `${what} waits`, running: `${what} is being made`, done: `${what} is done`, failed: `${what} has failed`, cancelled: `${what} is cancelled` }[job.state];
}

function head(job) {
  const busy = job.state === "running" || job.state === "waiting";
  const takes = job.took?.draft && job.full_by_draft ? `, about ${duration(job.took.draft * job.full_by_draft)}` : "";
  const buttons = busy
    ? [button("Cancel", "cancel", job, () => ask("POST", `/api/jobs/${job.id}/cancel`))]
    : [
        ...(job.runs.full ? [] : [button(`Make the full design${takes}`, "full", job, () => ask("POST", `/api/jobs/${job.id}/full`), "first")]),
        ...(job.runs.draft ? [] : [button("Make the draft", "draft", job, () => ask("POST", `/api/jobs/${job.id}/draft`))]),
      ];
  if (job.state !== "running") buttons.push(button("Delete", "delete", job, () => ask("DELETE", `/api/jobs/${job.id}`)));
  return [
    element("h3", {}, job.title),
    state(job),
    job.said ? element("p", { className: job.state === "failed" ? "red" : "muted" }, job.said) : "",
    job.state === "running" ? element("progress", { ariaLabel: `${job.title} is being made` }) : "",
    element("div", { className: "row" }, ...buttons),
    element("p", { className: "links" }, link(`/jobs/${job.id}/spec.yaml`, "Spec as YAML"), download(`/jobs/${job.id}/spec.zip`, "Spec with its pictures, ZIP")),
  ];
}

function state(job) {
  if (job.state !== "running") return element("p", { className: "muted" }, `${words(job)}, ${room(job.bytes)}`);
  const clock = element("span", {}, duration(Date.now() / 1000 - job.began));
  clock.dataset.began = job.began;
  return element("p", { className: "muted" }, `${words(job)}: `, clock);
}

function button(text, key, job, work, className = "") {
  const made = element("button", { type: "button", ariaLabel: `${text}: ${job.title}`, className }, text);
  made.dataset.key = key;
  made.addEventListener("click", () => trying(work));
  return made;
}

function results(job) {
  const [best, ...others] = ["full", "draft"].filter((want) => job.runs[want]).map((want) => result(job, want, job.runs[want]));
  if (!best) return [];
  return [best, ...others.map((other) => element("details", {}, element("summary", {}, "The draft before"), other))];
}

function result(job, want, run) {
  const at = (path) => `/jobs/${job.id}/${want}/${path.split("/").map(encodeURIComponent).join("/")}`;
  const coarse = want === "draft" && job.facets ? `A quick draft of ${run.facets} x ${run.facets} coarse facets. The full design has ${job.facets} x ${job.facets}, finer ones, and shows more.` : "";
  const downloads = want === "full" ? run.downloads : []; // nobody should print a draft
  const notes = run.checks.filter((c) => c.status === "amber" || c.status === "red");
  return element(
    "section",
    { ariaLabel: `${TITLES[want]} of ${job.title}` },
    element("h4", {}, TITLES[want]),
    element("p", { className: `verdict ${run.verdict?.status ?? ""}` }, run.verdict ? sentence(run.verdict.text) : "Not checked: no mesh was written."),
    element("p", { className: "muted" }, coarse),
    ...run.views.map((view) => element("div", { className: "views" }, ...figures(view, at))),
    run.pages.includes(VIEWER) ? viewer(at(VIEWER), job.title) : "",
    element("div", { className: "row" }, ...files(downloads.slice(0, MAIN_FILES), at, "button first")),
    element("p", { className: "links" }, ...run.pages.map((page) => link(at(page), PAGES[page])), download(at("share.gif"), "Film to share, GIF")),
    downloads.length > MAIN_FILES ? details("More files", files(downloads.slice(MAIN_FILES), at, "")) : "",
    details(`${notes.length || "No"} ${notes.length === 1 ? "remark" : "remarks"} before you make it`, notes.map((c) => `${c.check}: ${c.text}`)),
    details("How exactly sheet, lens and eye must be placed", run.tolerances),
  );
}

// The viewer is loaded when somebody opens it. It may run scripts, but has nothing to do with this page.
function viewer(href, title) {
  const box = element("details", { className: "viewer" }, element("summary", {}, "Move the lens over its sheet"));
  box.addEventListener("toggle", () => {
    if (!box.open || box.querySelector("iframe")) return;
    const frame = element("iframe", { title: `The viewer of ${title}` });
    frame.setAttribute("sandbox", "allow-scripts allow-downloads");
    frame.src = href;
    box.append(frame);
  });
  return box;
}

function files(downloads, at, className) {
  return downloads.map(({ path, title }) => download(at(path), title, className));
}

function figures(view, at) {
  const score = view.psnr_db === null ? "" : `, ${view.psnr_db.toFixed(1)} dB`;
  const pictures = [
    [view.source, "The sheet"],
    [view.target, "As wanted"],
    view.made ? [view.made, "As the machine makes it, simulated"] : [view.designed, `As designed${score}`],
  ];
  return pictures.filter(([path]) => path).map(([path, text]) =>
    element("figure", {}, element("img", { src: at(path), alt: `${view.name}: ${text}`, loading: "lazy" }), element("figcaption", {}, text)));
}

function sentence(text) {
  return `${text[0].toUpperCase()}${text.slice(1)}.`;
}

function details(title, lines) {
  return lines.length ? element("details", {}, element("summary", {}, title), element("ul", {}, ...lines.map((text) => element("li", {}, text)))) : "";
}

function link(href, text) {
  return element("a", { href, target: "_blank", rel: "noopener" }, text);
}

function download(href, text, className = "") {
  return element("a", { href, download: "", className }, text);
}
