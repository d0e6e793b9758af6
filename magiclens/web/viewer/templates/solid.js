// The solid, which can be turned, cut open, and coloured by slopes or steps.

// Most cells of the drawn grid along one side; finer lenses are drawn with fewer cells a facet.
const CELLS = 420;

function solidPicture(gl, lens, top) {
  const paint = program(gl, SHADERS.top + SHADERS.solidPoints, SHADERS.top + SHADERS.solid);
  const fine = Math.min(lens.microfacets, Math.max(2, Math.floor(CELLS / lens.facets)));
  const cells = lens.facets * (fine + 1) + 1;

  return (orbit, width, height, colors) => {
    const viewer = viewpoint(orbit, lens), back = toDisplay(colors.back);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(...back, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const turned = (orbit.cutAngle * Math.PI) / 180;
    paint({
      ...topUniforms(lens, top), fine: whole(fine), camera: camera(viewer, width / height, lens.size), viewer, glass: colors.glass,
      section: [-Math.cos(turned), -Math.sin(turned), 0, orbit.cut >= 100 ? 1e6 : (orbit.cut / 100 - 0.5) * 1.02 * lens.size],
      coloring: whole(orbit.coloring), steepest: (lens.steepest * Math.PI) / 180, highestStep: top.highestStep,
    });
    gl.drawArrays(gl.TRIANGLES, 0, 6 * (cells * cells + 4 * cells + 1));
  };
}

const toDisplay = (light) => light.map((c) => (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055));

function viewpoint(orbit, lens) {
  const around = (orbit.around * Math.PI) / 180, above = (orbit.above * Math.PI) / 180, far = orbit.far * lens.size;
  return [far * Math.cos(above) * Math.sin(around), -far * Math.cos(above) * Math.cos(around), far * Math.sin(above)];
}

// The matrix, column by column, of a perspective camera that looks at the origin, +z up.
function camera([x, y, z], aspect, size) {
  const far = Math.hypot(x, y, z), flat = Math.hypot(x, y) || 1e-6, zoom = 4.2 * Math.min(1, aspect / 1.2);
  const r = [-y / flat, x / flat, 0], f = [-x / far, -y / far, -z / far];
  const u = [r[1] * f[2] - r[2] * f[1], r[2] * f[0] - r[0] * f[2], r[0] * f[1] - r[1] * f[0]];
  const low = Math.max(far - size, 0.01 * size), high = far + size, a = (high + low) / (high - low), b = (-2 * high * low) / (high - low);
  const rows = [
    [...r.map((c) => (c * zoom) / aspect), 0], [...u.map((c) => c * zoom), 0],
    [...f.map((c) => c * a), a * far + b], [...f, far],
  ];
  return rows[0].flatMap((_, column) => rows.map((row) => row[column]));
}
