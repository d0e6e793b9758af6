// How much can be drawn in the time of a frame, learned from what was drawn before.

// Time for a frame while something moves, scales of width and height to choose from, and how many pictures may be under way:
// with one alone, the graphics would wait for the page. Of pictures of few pixels the time says little about larger ones.
const BUDGET_MS = 60, SCALES = [1, 0.75, 0.5, 0.35, 0.25, 0.15], UNDER_WAY = 2, MANY_PIXELS = 30000, LEAST_ROWS = 32;

function paceOf(gl) {
  const queue = [];
  let perPixel = 0, lastDone = 0, level = null;

  // The level at which a picture has no more than this share of all pixels; the last one if none has so few.
  function fitting(share) {
    const found = SCALES.findIndex((scale) => scale * scale <= share);
    return found < 0 ? SCALES.length - 1 : found;
  }

  function learn(now) {
    const { fence, began, pixels, moving, at } = queue.shift(), spent = now - Math.max(began, lastDone);
    gl.deleteSync(fence);
    lastDone = now;
    if (pixels >= MANY_PIXELS) perPixel = spent / pixels;
    if (!moving || level === null) return;
    if (spent > 1.3 * BUDGET_MS) level = Math.max(level, at + 1, fitting(SCALES[at] ** 2 * (BUDGET_MS / spent)));
    else if (spent < 0.5 * BUDGET_MS) level = at - 1;
    level = between(level, 0, SCALES.length - 1);
  }

  return {
    // Whether more may be drawn; a machine that is slow must not be given more than it can do.
    free(now) {
      while (queue.length && gl.getSyncParameter(queue[0].fence, gl.SYNC_STATUS) !== gl.UNSIGNALED) learn(now);
      return queue.length < UNDER_WAY;
    },
    drawn(now, pixels, moving) {
      queue.push({ fence: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), began: now, pixels, moving, at: level });
      gl.flush();
    },
    // The scale for a picture that had so many pixels at full size.
    scale(pixels) {
      level ??= perPixel ? fitting(BUDGET_MS / (pixels * perPixel)) : 0;
      return SCALES[level];
    },
    // How many rows of so many pixels are drawn in time.
    rows: (width, height) => (perPixel ? between(Math.floor(BUDGET_MS / (perPixel * width)), LEAST_ROWS, height) : height),
  };
}
