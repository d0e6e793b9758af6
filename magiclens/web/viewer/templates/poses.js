// Poses of lens and eye: homes of views, and how far a pose is from them. Views go by their number.

// Within these distances of its home, in mm and degrees, a lens that is dragged snaps into it.
const NEAR = 0.05 * lens.size, NEAR_ANGLE = 15, NEAR_LIFT = 4;
const EYE_PLACES = ["eyeX", "eyeY", "eyeDistance"];

// The home of a view: the pose in which its target appears.
function homePose(view) {
  const { eye: [x, y, z], rotation } = views[view];
  return { x: 0, y: 0, angle: rotation, lift: 0, eyeX: x, eyeY: y, eyeDistance: z - lens.thickness };
}

// Beside the sheet, so that all of it can be seen.
function asidePose(view) {
  const away = SHEET + 0.53, [x, y] = narrow() ? [0.08, -away] : [away, -0.06];
  return { ...homePose(view), x: x * lens.size, y: y * lens.size, angle: views[view].rotation - 9 };
}

// The pose within what can still be seen and reached.
function clamped(at) {
  const half = lens.size, reach = 0.75 * at.eyeDistance;
  return {
    x: between(at.x, -half, 1.45 * half), y: between(at.y, -1.4 * half, half), angle: at.angle, lift: between(at.lift, 0, 0.6 * lens.size),
    eyeX: between(at.eyeX, -reach, reach), eyeY: between(at.eyeY, -reach, reach),
    eyeDistance: between(at.eyeDistance, 0.4 * data.distance, 2 * data.distance),
  };
}

// The pose at a share t of the way from one to another; slow at both ends, and the short way round.
function onTheWay(from, to, t) {
  const eased = t * t * (3 - 2 * t), last = { ...to, angle: from.angle + folded(to.angle - from.angle) };
  return t >= 1 ? last : Object.fromEntries(Object.keys(from).map((key) => [key, from[key] + (last[key] - from[key]) * eased]));
}

// Whether two views have the same source and eye.
const alike = (a, b) => views[a].source === views[b].source && views[a].eye.every((c, k) => Math.abs(c - views[b].eye[k]) < 1e-6);

// Of the views that are like one, that whose home is nearest, by turning first, and how far the lens is from it.
function nearestHome(at, view) {
  return views
    .map(({ rotation }, index) => ({ index, off: Math.hypot(at.x, at.y), turn: Math.abs(folded(at.angle - rotation)) }))
    .filter((home) => alike(home.index, view))
    .sort((a, b) => a.turn - b.turn || (a.index === view ? -1 : 0))[0];
}

// How far the lens is from the nearest home, as one number.
function awayFromHome(at, view) {
  const { off, turn } = nearestHome(at, view);
  return off / lens.size + turn / 90 + Math.abs(at.lift) / lens.size;
}

// The view and the pose, or those of the nearest home if that is within these distances.
function snapped(at, view, within, turn, lift) {
  const near = nearestHome(at, view);
  if (near.off > within || near.turn > turn || at.lift > lift) return [view, at];
  return [near.index, { ...at, x: 0, y: 0, angle: at.angle - folded(at.angle - views[near.index].rotation), lift: 0 }];
}
