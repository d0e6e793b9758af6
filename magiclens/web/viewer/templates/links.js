// The pose in the address of the page, so that a link leads to it: #view=1&x=3&y=-2.5&angle=15&tab=solid.

const POSE_KEYS = ["x", "y", "angle", "lift", "eyeX", "eyeY", "eyeDistance"];

function addressOf({ view, pose, tab }) {
  const home = homePose(view), words = new URLSearchParams({ view });
  for (const key of POSE_KEYS) if (Math.abs(pose[key] - home[key]) > 0.005) words.set(key, Number(pose[key].toFixed(2)));
  if (tab !== "table") words.set("tab", tab);
  return `#${words}`;
}

// What the address asks for; nothing if it is for another part of the page.
function askedByAddress() {
  const words = new URLSearchParams(location.hash.slice(1)), view = Number(words.get("view"));
  if (!words.has("view") || !views[view]) return null;
  const given = POSE_KEYS.filter((key) => words.has(key) && Number.isFinite(Number(words.get(key))));
  return { view, tab: words.get("tab") === "solid" ? "solid" : "table", pose: { ...homePose(view), ...Object.fromEntries(given.map((key) => [key, Number(words.get(key))])) } };
}

async function copyLink(look) {
  const address = addressOf(look);
  try {
    history.replaceState(null, "", address);
  } catch {
    location.hash = address;
  }
  const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
  say(copied ? "The link to this is copied." : "The address of this page now leads here.");
}
