// What is looked at: the tab, the view, the top of the lens, the pose of lens and eye, the camera around the solid.

class Look {
  tab = "table";
  view = 0;
  top = 0; // of ``data.tops``: as printed comes before as designed
  orbit = startOrbit();
  found = false; // whether the lens is at home
  greeted = false; // a user who has brought the lens home once needs no hint
  seen = new Set();

  // ``told`` is called after a change, with whether it shall count as rest: then the next picture is a fine one.
  constructor(told) {
    this.pose = homePose(0);
    this.told = told;
  }

  move(change, still = false) {
    this.pose = clamped({ ...this.pose, ...change });
    this.told(still);
  }

  turnAbout(change) {
    this.orbit = { ...this.orbit, ...change };
    this.orbit.above = between(this.orbit.above, -89, 89);
    this.orbit.far = between(this.orbit.far, 1.6, 9);
    this.told(false);
  }

  // Moves lens and eye as a hand does, which lets go of the lens in its home if it comes so near.
  settle(raw, ...near) {
    const [view, pose] = snapped(raw, this.view, ...near);
    Object.assign(this, { view, pose: clamped(pose) });
    this.checkHome();
    this.greeted ||= this.found;
    this.told(false);
  }

  // Whether lens and eye are at home; marks the view as seen if the lens is.
  checkHome() {
    const near = nearestHome(this.pose, this.view);
    this.found = near.off < 0.01 && near.turn < 0.01 && this.pose.lift < 0.01;
    if (this.found) {
      this.view = near.index;
      this.seen.add(near.index);
    }
    const home = homePose(this.view);
    return this.found && Math.hypot(...EYE_PLACES.map((key) => this.pose[key] - home[key])) < 0.01;
  }

  forget() {
    this.greeted = false;
    this.seen.clear();
  }
}

function startOrbit() {
  return { around: -28, above: 52, far: 3.6, cut: 100, cutAngle: 90, coloring: 0 };
}
