// The table: the source, the lens on it, an eye above. While nothing moves, samples add up to a finer picture.

// Samples a pixel along each axis.
const SAMPLES = 4;
// Offset of the samples, in their widths. Without it, whole rows of pixels would hit the walls between facets.
const OFF = [0.057, 0.083];

// Position of the k-th sample in its pixel, from the lower left, in widths of a sample: a turned grid as in the tracer.
function turnedGrid(k, samples) {
  const a = k % samples, b = Math.floor(k / samples);
  return [a + (samples - b - 0.5) / samples, b + (a + 0.5) / samples];
}

function tablePicture(gl, lens, top) {
  const fine = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
  const trace = program(gl, SHADERS.screen, SHADERS.top + SHADERS.light + SHADERS.table);
  const show = program(gl, SHADERS.screen, SHADERS.shown);
  const smooth = { MIN_FILTER: "LINEAR", MAG_FILTER: "LINEAR", WRAP_S: "CLAMP_TO_EDGE", WRAP_T: "CLAMP_TO_EDGE" };
  const source = texture(gl, 1, { ...smooth, MIN_FILTER: "LINEAR_MIPMAP_LINEAR" });
  const frame = gl.createFramebuffer(), light = texture(gl, 2, smooth);
  let size = [0, 0], perMm = 1;

  function lay(image) {
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, source);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    perMm = image.naturalWidth / lens.source_size;
  }

  // What shaders need to know of the sheet; it lies in texture unit 1.
  const sheet = () => ({ source: whole(1), sourceHalf: lens.source_size / 2, darkest: lens.darkest, perMm });

  function resize(width, height) {
    if (size[0] === width && size[1] === height) return;
    size = [width, height];
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, light);
    const [inside, kind] = fine ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, gl.RGBA, kind, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, light, 0);
  }

  // Adds one sample to each pixel of some rows, from the lowest row on. ``view`` is the eye, the lower left corner and the steps of a pixel in the lens's frame.
  function add(view, pose, colors, index, samples, exact, rows = [0, view.height]) {
    const { width, height } = view, count = samples * samples, turned = (pose.angle * Math.PI) / 180;
    // 7 and 16 have no common divisor, so each sample comes once, and the first few are spread over the pixel
    const k = count === 16 ? (index * 7) % 16 : index;
    const blurred = Math.log2(Math.max(perMm * view.perPixel, 1));
    resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, rows[0], width, rows[1]);
    if (index) gl.enable(gl.BLEND);
    gl.blendColor(0, 0, 0, 1 / (index + 1));
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    trace({
      ...topUniforms(lens, top), ...sheet(), lowest: top.lowest, highest: top.highest, gap: lens.gap + pose.lift,
      ior: lens.ior, exact: whole(exact ? 1 : 0),
      lod: count === 1 ? blurred : Math.max(blurred - Math.log2(samples), 0) * (exact ? 0 : 1), ...colors,
      pose: [pose.x, pose.y, Math.cos(turned), Math.sin(turned)], eye: view.eye, origin: view.origin, right: view.right, up: view.up,
      jitter: turnedGrid(k, samples).map((position, axis) => (position + (exact ? 0 : OFF[axis])) / samples),
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
    gl.disable(gl.SCISSOR_TEST);
  }

  function present(width, height) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    show({ light: whole(2), screen: [width, height] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // The picture (height, width, 3) in linear light, first row on top.
  function readLight(width, height) {
    const all = new Float32Array(width * height * 4), found = [];
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, all);
    for (let row = height - 1; row >= 0; row--) {
      for (let i = row * width * 4; i < (row + 1) * width * 4; i += 4) found.push(all[i], all[i + 1], all[i + 2]);
    }
    return found;
  }

  return { lay, add, sheet, present, light: readLight, most: fine ? SAMPLES * SAMPLES : 1 };
}

// From the world to the frame of the lens: the origin is its centre, z counts from its reference plane.
function toLens(pose, lens, [x, y, z], isPoint = true) {
  const turned = (pose.angle * Math.PI) / 180, c = Math.cos(turned), s = Math.sin(turned);
  const [dx, dy, dz] = isPoint ? [x - pose.x, y - pose.y, z - lens.thickness - pose.lift] : [x, y, z];
  return [c * dx + s * dy, c * dy - s * dx, dz];
}

const eyeOf = (pose, lens) => [pose.eyeX, pose.eyeY, lens.thickness + pose.eyeDistance];

// The view of the whole table: pixels have equal size on the plane of the lens's top at home.
function tableView(pose, lens, width, height, perPixel, middle) {
  const corner = [middle[0] - (width / 2) * perPixel, middle[1] - (height / 2) * perPixel, lens.thickness];
  return {
    width, height, perPixel, eye: toLens(pose, lens, eyeOf(pose, lens)), origin: toLens(pose, lens, corner),
    right: toLens(pose, lens, [perPixel, 0, 0], false), up: toLens(pose, lens, [0, perPixel, 0], false),
  };
}

// The view of the lens's square alone, at any pose.
function lensView(pose, lens, size) {
  const perPixel = lens.size / size;
  return {
    width: size, height: size, perPixel, eye: toLens(pose, lens, eyeOf(pose, lens)),
    origin: [-lens.size / 2, -lens.size / 2, 0], right: [perPixel, 0, 0], up: [0, perPixel, 0],
  };
}
