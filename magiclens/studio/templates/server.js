// What the server is asked, and how its refusals become errors that say where and what.
export class Refused extends Error {
  constructor(errors) {
    super(errors.map((e) => e.message).join("\n"));
    this.errors = errors;
  }
}

export async function ask(method, path, body) {
  let answer;
  try {
    answer = await fetch(path, { method, body: body instanceof Blob || !body ? body : JSON.stringify(body) });
  } catch {
    throw new Refused([{ where: null, message: "The studio does not answer. Is it still running?" }]);
  }
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const text = await answer.text();
  let errors;
  try {
    ({ errors } = JSON.parse(text));
  } catch {
    errors = [{ where: null, message: text.trim() }];
  }
  throw new Refused(errors);
}

export function element(tag, values = {}, ...children) {
  const made = Object.assign(document.createElement(tag), values);
  made.append(...children.filter((child) => child !== null));
  return made;
}

export function say(text) {
  document.getElementById("status").textContent = text;
}

export function complain(error) {
  const box = document.getElementById("errors");
  const errors = error instanceof Refused ? error.errors : [{ where: null, message: String(error) }];
  box.replaceChildren(...errors.map((e) => element("p", {}, e.where ? `${e.where}: ${e.message}` : e.message)));
  box.scrollIntoView({ block: "nearest" });
}

export function noComplaint() {
  document.getElementById("errors").replaceChildren();
}

export function room(bytes) {
  return bytes < 1e6 ? `${Math.ceil(bytes / 1e3)} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`;
}

export function duration(seconds) {
  const whole = Math.max(Math.round(seconds), 1);
  if (whole < 90) return `${whole} s`;
  return whole < 5400 ? `${Math.round(whole / 60)} minutes` : `${Math.round(whole / 3600)} hours`;
}
