// The solid, which can be turned, cut open, and coloured by slopes or steps.

// Most cells of the drawn grid along one side; finer lenses are drawn with fewer cells a facet.
const CELLS = 420;

function solidPicture(gl, lens, top) {
  const around = SHADERS.top + SHADERS.light + SHADERS.bench;
  const paint = program(gl, SHADERS.top + SHADERS.solidPoints, around + SHADERS.solid);
  const surround = program(gl, SHADERS.screen, around + SHADERS.behind);
  const fine = Math.min(lens.microfacets, Math.max(2, Math.floor(CELLS / lens.facets)));
  const cells = lens.facets * (fine + 1) + 1;

  // ``sheet`` has what the table knows of the source: its unit, size and darkest light.
  return (orbit, width, height, colors, rotation, sheet) => {
    const viewer = viewpoint(orbit, lens), { rows, right, up, forward, perPixel } = camera(viewer, width / height, extentOf(lens));
    const turned = (orbit.cutAngle * Math.PI) / 180, home = (rotation * Math.PI) / 180;
    const scene = {
      ...topUniforms(lens, top), ...sheet, gap: lens.gap, ior: lens.ior, viewer, wood: colors.wood, back: colors.back,
      turn: [Math.cos(home), Math.sin(home)], lod: Math.max(Math.log2((sheet.perMm * perPixel) / height), 0),
    };
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    surround({ ...scene, right, up, forward, screen: [width, height] });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    paint({
      ...scene, fine: whole(fine), camera: rows, glass: colors.glass,
      section: [-Math.cos(turned), -Math.sin(turned), 0, orbit.cut >= 100 ? 1e6 : (orbit.cut / 100 - 0.5) * 1.02 * lens.size],
      coloring: whole(orbit.coloring), steepest: (lens.steepest * Math.PI) / 180, highestStep: top.highestStep,
    });
    gl.drawArrays(gl.TRIANGLES, 0, 6 * (cells * cells + 4 * cells + 1));
  };
}

// What has to fit into the picture, mm: the side of the lens, or more if it is tall.
const extentOf = (lens) => Math.max(lens.size, 0.85 * Math.hypot(lens.size, lens.thickness));

function viewpoint(orbit, lens) {
  const around = (orbit.around * Math.PI) / 180, above = (orbit.above * Math.PI) / 180, far = orbit.far * extentOf(lens);
  return [far * Math.cos(above) * Math.sin(around), -far * Math.cos(above) * Math.cos(around), far * Math.sin(above)];
}

// A perspective camera that looks at the origin, +z up: its matrix column by column, the directions of the picture's middle
// and of half its width and height, and how many mm the picture is high where it looks.
function camera([x, y, z], aspect, size) {
  const far = Math.hypot(x, y, z), flat = Math.hypot(x, y) || 1e-6, zoom = 4.2 * Math.min(1, aspect / 1.2);
  const r = [-y / flat, x / flat, 0], f = [-x / far, -y / far, -z / far];
  const u = [r[1] * f[2] - r[2] * f[1], r[2] * f[0] - r[0] * f[2], r[0] * f[1] - r[1] * f[0]];
  const low = Math.max(far - size, 0.01 * size), high = far + size, a = (high + low) / (high - low), b = (-2 * high * low) / (high - low);
  const rows = [
    [...r.map((c) => (c * zoom) / aspect), 0], [...u.map((c) => c * zoom), 0],
    [...f.map((c) => c * a), a * far + b], [...f, far],
  ];
  return {
    rows: rows[0].flatMap((_, column) => rows.map((row) => row[column])), forward: f, perPixel: (2 * far) / zoom,
    right: r.map((c) => (c * aspect) / zoom), up: u.map((c) => c / zoom),
  };
}
