// The page: listens to the server's events, and hands what they say to the parts.
import { showJobs } from "./jobs.js";
import { listen, showPictures } from "./orders.js";
import { say } from "./server.js";

history.replaceState(null, "", "/"); // the token is a cookie now
listen();
const events = new EventSource("/api/events");
let lost = false;
events.addEventListener("message", (event) => {
  if (lost) say("The studio is there again");
  lost = false;
  const state = JSON.parse(event.data);
  showPictures(state.pictures);
  showJobs(state.jobs, state.bytes, state.kept_bytes);
});
events.addEventListener("error", () => {
  lost = true;
  const over = events.readyState === EventSource.CLOSED;
  say(over ? "Open the address that the terminal shows" : "The studio does not answer; trying again");
});
