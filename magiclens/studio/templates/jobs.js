// The list of jobs: state, progress, results. What has not changed is left alone, so that focus and reading stay.
import { ask, complain, element, noComplaint, room, say } from "./server.js";

const list = document.getElementById("jobs");
const shown = new Map();
const TITLES = { draft: "Draft", full: "Full design" };
const PAGES = { "report.html": "Report", "preflight.html": "Preflight", "view.html": "Move the lens over its source" };

export function showJobs(jobs, bytes) {
  document.getElementById("room").textContent = `${room(bytes)} on the disk, results kept for later runs included.`;
  const there = new Set(jobs.map((job) => job.id));
  for (const [id, known] of shown) {
    if (!there.has(id)) {
      known.box.remove();
      shown.delete(id);
    }
  }
  if (!jobs.length) list.replaceChildren(element("p", { className: "muted" }, "None yet."));
  if (jobs.length && !shown.size) list.replaceChildren();
  jobs.toReversed().forEach((job) => show(job));
}

function show(job) {
  if (!shown.has(job.id)) {
    const [head, results] = [element("div"), element("div")];
    const box = element("article", { className: "job", id: `job-${job.id}` }, head, results);
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
  const buttons = busy
    ? [button("Cancel", "cancel", job, () => ask("POST", `/api/jobs/${job.id}/cancel`))]
    : [
        button(job.runs.draft ? "Draft again" : "Make the draft", "draft", job, () => ask("POST", `/api/jobs/${job.id}/draft`)),
        button("Make the full design", "full", job, () => ask("POST", `/api/jobs/${job.id}/full`)),
      ];
  if (job.state !== "running") buttons.push(button("Delete", "delete", job, () => ask("DELETE", `/api/jobs/${job.id}`)));
  return [
    element("h3", {}, job.title),
    element("p", {}, `${words(job)}, ${room(job.bytes)}`),
    job.said ? element("p", { className: job.state === "failed" ? "red" : "muted" }, job.said) : "",
    job.state === "running" ? element("progress", { ariaLabel: `${job.title} is being made` }) : "",
    element("div", { className: "row" }, ...buttons, element("a", { href: `/jobs/${job.id}/spec.yaml` }, "Spec as YAML")),
  ];
}

function button(text, key, job, work) {
  const made = element("button", { type: "button", ariaLabel: `${text}: ${job.title}` }, text);
  made.dataset.key = key;
  made.addEventListener("click", async () => {
    noComplaint();
    try {
      await work();
    } catch (error) {
      complain(error);
    }
  });
  return made;
}

function results(job) {
  return ["full", "draft"].filter((want) => job.runs[want]).map((want) => result(job, want, job.runs[want]));
}

function result(job, want, run) {
  const at = (path) => `/jobs/${job.id}/${want}/${path.split("/").map(encodeURIComponent).join("/")}`;
  const verdict = run.status ? `Preflight: ${run.status}` : "No preflight: no mesh was written";
  return element(
    "section",
    { ariaLabel: `${TITLES[want]} of ${job.title}` },
    element("h4", {}, TITLES[want]),
    element("div", { className: "views" }, ...run.views.flatMap((view) => figures(view, at))),
    element("p", { className: `verdict ${run.status ?? ""}` }, verdict),
    element("ul", {}, ...run.checks.filter((c) => c.status !== "green").map((c) => element("li", {}, `${c.check}: ${c.text}`))),
    details("What preflight has found", run.checks.map((c) => `${c.status}, ${c.check}: ${c.text}`)),
    details("Tolerances, until the picture has lost 3 dB", run.tolerances),
    element("p", {}, ...run.pages.flatMap((page) => [link(at(page), PAGES[page]), " "])),
    element("p", {}, "Files: ", ...run.downloads.flatMap((path) => [download(at(path), path), " "])),
  );
}

function figures(view, at) {
  const score = view.psnr_db === null ? "" : `, ${view.psnr_db.toFixed(1)} dB`;
  const pictures = [
    [view.target, `${view.name}: as wanted`],
    [view.designed, `${view.name}: as designed${score}`],
    [view.made, `${view.name}: as the machine makes it`],
  ];
  return pictures.filter(([path]) => path).map(([path, text]) =>
    element("figure", {}, element("img", { src: at(path), alt: text, loading: "lazy" }), element("figcaption", {}, text)));
}

function details(title, lines) {
  return lines.length ? element("details", {}, element("summary", {}, title), element("ul", {}, ...lines.map((text) => element("li", {}, text)))) : "";
}

function link(href, text) {
  return element("a", { href, target: "_blank", rel: "noopener" }, text);
}

function download(href, text) {
  return element("a", { href, download: "" }, text);
}
