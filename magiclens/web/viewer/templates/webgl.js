// Helpers around WebGL2, for the table and the solid.

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\nprecision highp sampler2D;\n";

// Compiles a program; returns a function that makes it current and sets its uniforms by name.
function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, HEAD + text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made));
  const locations = {};
  return (values) => {
    gl.useProgram(made);
    for (const [name, value] of Object.entries(values)) {
      if (!(name in locations)) locations[name] = gl.getUniformLocation(made, name);
      setUniform(gl, locations[name], value);
    }
  };
}

// A plain number is a float, a list a vector or (16 numbers) a matrix; an int or a sampler is wrapped in ``whole``.
const whole = (value) => ({ whole: value });

function setUniform(gl, location, value) {
  if (typeof value === "number") gl.uniform1f(location, value);
  else if (value.whole !== undefined) gl.uniform1i(location, value.whole);
  else if (value.length === 16) gl.uniformMatrix4fv(location, false, value);
  else gl[`uniform${value.length}fv`](location, value);
}

function texture(gl, unit, settings) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const [name, value] of Object.entries(settings)) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl[value]);
  return made;
}

function topUniforms(lens, top) {
  return {
    heights: whole(0), facets: whole(lens.facets), micro: whole(lens.microfacets), pitch: lens.pitch,
    side: lens.pitch - lens.wall, size: lens.size, edge: lens.size / 2 + lens.bleed,
    cut: top.eye ? [top.eye[0], top.eye[1], top.perDistance] : [0, 0, 0], thickness: lens.thickness, base: top.base,
  };
}

function heightTexture(gl, top) {
  if (top.side > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("This lens is too fine for this device's graphics.");
  gl.activeTexture(gl.TEXTURE0);
  gl.deleteTexture(gl.getParameter(gl.TEXTURE_BINDING_2D)); // of another top
  texture(gl, 0, { MIN_FILTER: "NEAREST", MAG_FILTER: "NEAREST", WRAP_S: "CLAMP_TO_EDGE", WRAP_T: "CLAMP_TO_EDGE" });
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, top.side, top.side, 0, gl.RED, gl.FLOAT, top.grid);
}
