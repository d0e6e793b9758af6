// The pose in words, and hints.


const inWords = (value, plus, minus) => (Math.abs(value) < 0.05 ? "" : `${Math.abs(value).toFixed(1).replace(/\.0$/, "")} mm ${value > 0 ? plus : minus}`);
const listed = (items, otherwise) => items.filter(Boolean).join(", ") || otherwise;

function described({ pose, view, found }, atHome) {
  const turn = folded(pose.angle);
  const position = listed([inWords(pose.x, "right", "left"), inWords(pose.y, "up", "down"), inWords(pose.lift, "lifted", "lowered"),
    Math.abs(turn) > 0.05 && `turned ${Math.abs(turn).toFixed(0)}° ${turn > 0 ? "left" : "right"}`], "in the middle");
  const eye = listed([inWords(pose.eyeX, "right", "left"), inWords(pose.eyeY, "up", "down")], "straight above");
  if (atHome) return `In place: ${views[view].label}.`;
  const first = found ? `In place for ${views[view].label}, but seen from elsewhere` : `Lens ${position}`;
  return `${first}. Eye ${eye}, ${pose.eyeDistance.toFixed(0)} mm away.`;
}

// Screen readers are told when the lens rests, not of each step on its way.
const say = (() => {
  let waiting = 0;
  return (text) => {
    clearTimeout(waiting);
    waiting = setTimeout(() => (part("readout").textContent = text), 250);
  };
})();

function hint({ view, found, greeted, seen }) {
  const others = views.some(({ rotation }, k) => k !== view && rotation !== views[view].rotation && alike(k, view));
  if (found) return greeted && others && seen.size === 1 ? "Now turn it: there is more to see" : "";
  return greeted ? "" : "Drag the lens onto the outline";
}
