"""The web page's script, of which the drawing is here: WebGL 2 and nothing else; a buffer holds all frames.

Rows of a buffer are four numbers long (position and measure; normal), as graphics cards read them without conversion.
"""

from warpdef.apps.viewer.script_controls import CONTROLS_SCRIPT
from warpdef.apps.viewer.script_data import DATA_SCRIPT

SCRIPT = (
    DATA_SCRIPT
    + r"""
// Camera: angles about the focus; "up" is y or z of the data.
const frameOf = S.up === "z" ? v => [v[0], -v[2], v[1]] : v => v;
const opening = Math.tan(S.angle * Math.PI / 360);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
let outline = new Float32Array(0), cam = null, tiles = { columns: 1, rows: 1, width: 1, height: 1 };
function axesOf(a, e) {
  const ca = Math.cos(a), sa = Math.sin(a), ce = Math.cos(e), se = Math.sin(e);
  return [[ca, 0, -sa], [-sa * se, ce, -ca * se], [sa * ce, se, ca * ce]].map(frameOf);
}
// What is seen lies along the camera's axes at x, y, z: within the opening k of a camera at (cx, cy, cz) if
// |x - cx| <= k (cz - z). Of all places of the motion only the largest sums and differences count.
function fitted(a, e, kx, ky) {
  const axes = axesOf(a, e), least = [Infinity, Infinity, Infinity], most = [-Infinity, -Infinity, -Infinity];
  const plus = [-Infinity, -Infinity], minus = [-Infinity, -Infinity], f = S.focus;
  for (let i = 0; i < outline.length; i += 3) {
    const p = [outline[i] - f[0], outline[i + 1] - f[1], outline[i + 2] - f[2]], q = axes.map(axis => dot(axis, p));
    for (let j = 0; j < 3; j++) { least[j] = Math.min(least[j], q[j]); most[j] = Math.max(most[j], q[j]); }
    [kx, ky].forEach((k, j) => {
      plus[j] = Math.max(plus[j], q[j] + k * q[2]);
      minus[j] = Math.max(minus[j], k * q[2] - q[j]);
    });
  }
  const size = least.map((l, j) => most[j] - l);
  // Nothing may lie behind the camera, flat things seen along their plane neither.
  let d = most[2] + 0.1 * Math.max(...size);
  [kx, ky].forEach((k, j) => { d = Math.max(d, (plus[j] + minus[j]) / (2 * k)); });
  return { d, size, aside: [0, 1].map(j => (plus[j] - minus[j]) / 2) };
}
function usual() {
  const a = S.azimuth * Math.PI / 180, e = S.elevation * Math.PI / 180, { width, height } = tiles;
  const top = Math.min(40, 0.15 * height), below = 12;  // a title stands above
  const ky = opening * (height - top - below) / height, kx = opening * width / height * (1 - 24 / Math.max(width, 48));
  const [right, above] = axesOf(a, e), fit = fitted(a, e, kx, ky), d = (fit.d || 1) / S.zoom;
  const lift = fit.aside[1] + (top - below) / height * d * opening;
  const f = S.focus.map((c, i) => c + fit.aside[0] * right[i] + lift * above[i]);
  return { a, e, d, f, usual: d, home: true };
}
// Rows and columns of panes: those that show the figure largest, and leave a title its room.
function arrange() {
  const canvas = $("canvas"), w = canvas.clientWidth || 1, h = canvas.clientHeight || 1, n = S.panes.length;
  const size = fitted(S.azimuth * Math.PI / 180, S.elevation * Math.PI / 180, 1, 1).size;
  let best = -1;
  for (let columns = 1; columns <= n; columns++) {
    const rows = Math.ceil(n / columns), width = w / columns, height = h / rows;
    const scale = Math.min(width / size[0], (height - 40) / size[1]) * (columns > 1 && width < 150 ? 0.1 : 1);
    if (scale > best * 1.0001) { best = scale; tiles = { columns, rows, width, height }; }
  }
  const { columns, width, height } = tiles;
  root.columns = columns;
  tiles.places = S.panes.map((_, i) => {
    const row = Math.floor(i / columns), inRow = Math.min(columns, n - row * columns);
    return [(i % columns) * width + (w - inRow * width) / 2, row * height];
  });
  [...$("titles").children].forEach((title, i) => {
    const [left, top] = tiles.places[i].map(c => `${c}px`);
    Object.assign(title.style, { left, top, width: `${width}px` });
  });
  if (!cam || cam.home) cam = usual();
  dirty = true;
}
function matrices(aspect) {
  const [r, u, b] = axesOf(cam.a, cam.e), eye = cam.f.map((c, i) => c + cam.d * b[i]);
  const f = 1 / opening, around = Math.hypot(...S.size), near = Math.max(cam.d / 200, cam.d - 1.5 * around);
  const far = 1.5 * (around + cam.d), A = (near + far) / (near - far), B = 2 * near * far / (near - far);
  const row = (v, s) => [s * v[0], s * v[1], s * v[2], -s * dot(v, eye)];
  const X = row(r, f / aspect), Y = row(u, f), Z = row(b, A), W = row(b, -1);
  Z[3] += B;
  const m = new Float32Array(16);
  for (let i = 0; i < 4; i++) { m[4 * i] = X[i]; m[4 * i + 1] = Y[i]; m[4 * i + 2] = Z[i]; m[4 * i + 3] = W[i]; }
  return [m, b, u];
}

const gl = $("canvas").getContext("webgl2", { antialias: true });
if (!gl) fail("This page needs WebGL 2, which this browser does not offer.");

const VERTEX = `#version 300 es
in vec4 p0; in vec4 p1; in vec3 n0; in vec3 n1; in vec3 color; in vec3 rest;
uniform mat4 view; uniform vec3 low, size; uniform float mixing, pointScale, pixel; uniform int kind;
uniform sampler2D table; uniform vec4 cells;
out vec3 tint, normal, place, cell;
void main() {
  place = low + size * mix(p0.xyz, p1.xyz, mixing);
  normal = mix(n0, n1, mixing);
  tint = color;
  cell = (low + size * rest - cells.xyz) * cells.w + 0.5;
  if (kind == 2) {
    float a = p0.w * 65535.0, b = p1.w * 65535.0, v = a > 254.5 || b > 254.5 ? 255.0 : mix(a, b, mixing);
    tint = texture(table, vec2((v + 0.5) / 256.0, 0.5)).rgb;
  }
  gl_Position = view * vec4(place, 1.0);
  gl_PointSize = clamp(pointScale / gl_Position.w, pixel, 6.0 * pixel);
}`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in vec3 tint, normal, place, cell; uniform vec3 toEye, above, plain; uniform int shading, kind; uniform float dark;
out vec4 result;
void main() {
  vec3 base = kind == 0 ? plain : tint;
  if (kind == 1 && dark > 0.0) {
    // A checker of cubes at rest: the product of three square waves, each as steep as a pixel is wide.
    vec3 away = abs(2.0 * fract(0.5 * cell + 0.25) - 1.0) - 0.5;
    vec3 waves = 2.0 * clamp(away / max(fwidth(cell), vec3(1e-6)), -0.5, 0.5);
    base *= 1.0 - dark * (0.5 - 0.5 * waves.x * waves.y * waves.z);
  }
  if (shading == 3 && length(gl_PointCoord - 0.5) > 0.5) discard;
  if (shading >= 2) { result = vec4(base, 1.0); return; }
  vec3 n = shading == 1 ? normal : cross(dFdx(place), dFdy(place));
  n = normalize(n);
  if (dot(n, toEye) < 0.0) n = -n;
  float key = max(dot(n, normalize(toEye + 0.6 * above)), 0.0), sky = 0.5 + 0.5 * dot(n, above);
  result = vec4(base * (0.36 + 0.6 * key + 0.14 * sky), 1.0);
}`;

function program() {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  ["p0", "p1", "n0", "n1", "color", "rest"].forEach((name, i) => gl.bindAttribLocation(made, i, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}
function buffer(data, target) {
  const made = gl.createBuffer();
  gl.bindBuffer(target, made);
  gl.bufferData(target, data, gl.STATIC_DRAW);
  return made;
}
function texture(pixels) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, pixels.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, pixels);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  return made;
}

// About so many places of a pane, in input units, for the camera.
function sample(rows, most) {
  const step = 4 * Math.ceil(rows.length / 4 / most), out = [];
  for (let i = 0; i < rows.length; i += step)
    for (let c = 0; c < 3; c++) out.push(S.low[c] + S.size[c] * rows[i + c] / 65535);
  return out;
}
async function prepare(pane) {
  const made = { title: pane.title, measured: !!pane.values, checker: pane.checker, outline: [] };
  made.colorful = pane.colorful;
  made.table = texture(pane.table ? await inflate(pane.table) : new Uint8Array(3));
  if (pane.faces) {
    const count = pane.count, faces = await indices(pane.faces), near = lowerNeighbours(faces, count);
    const rows = new Uint16Array(S.frames * count * 4);
    await moving(pane.positions, S.frames, count, 3, 2, near, rows, 0);
    if (pane.values) await moving(pane.values, S.frames, count, 1, 1, near, rows, 3);
    Object.assign(made, { count, triangles: faces, outline: sample(rows, 50000) });
    made.rows = buffer(rows, gl.ARRAY_BUFFER);
    made.normals = buffer(await normals(rows, faces, count), gl.ARRAY_BUFFER);
    made.faces = buffer(faces, gl.ELEMENT_ARRAY_BUFFER);
    if (pane.colors) made.colors = buffer(await inflate(pane.colors), gl.ARRAY_BUFFER);
  }
  if (pane.cloud) {
    const total = pane.cloudCounts.reduce((a, b) => a + b, 0), rows = new Uint16Array(4 * total);
    await moving(pane.cloud, 1, total, 3, 2, Int32Array.from({ length: total }, (_, i) => i - 1), rows, 0);
    made.cloud = buffer(rows, gl.ARRAY_BUFFER);
    made.cloudCounts = pane.cloudCounts;
    made.cloudStarts = pane.cloudCounts.map((_, i) => pane.cloudCounts.slice(0, i).reduce((a, b) => a + b, 0));
    if (!pane.faces) made.outline = sample(rows, 50000);
  }
  return made;
}

let U, panes = [], dirty = true, playing = false, at = S.frame, last = 0, drawn = 0;
function attribute(index, source, size, kind, normalized, offset) {
  if (!source) { gl.disableVertexAttribArray(index); return; }
  gl.bindBuffer(gl.ARRAY_BUFFER, source);
  gl.enableVertexAttribArray(index);
  gl.vertexAttribPointer(index, size, kind, normalized, kind === gl.UNSIGNED_SHORT ? 8 : 4, offset);
}
function drawPane(pane, x, y, width, height, scale) {
  gl.viewport(x, y, width, height);
  const [view, toEye, above] = matrices(width / height);
  gl.uniformMatrix4fv(U.view, false, view);
  gl.uniform3fv(U.toEye, toEye);
  gl.uniform3fv(U.above, above);
  gl.bindTexture(gl.TEXTURE_2D, pane.table);
  const now = Math.floor(at), next = Math.min(now + 1, S.frames - 1), mixing = $("blend").checked ? at - now : 0;
  if (pane.faces) {
    gl.uniform1f(U.mixing, mixing);
    [now, next].forEach((t, i) => {
      attribute(i, pane.rows, 4, gl.UNSIGNED_SHORT, true, 8 * t * pane.count);
      attribute(2 + i, pane.normals, 4, gl.BYTE, true, 4 * t * pane.count);
    });
    attribute(4, pane.colors, 4, gl.UNSIGNED_BYTE, true, pane.colorful ? 4 * now * pane.count : 0);
    const checker = pane.checker;
    gl.uniform1f(U.dark, checker ? checker.dark : 0);
    if (checker) {
      attribute(5, pane.rows, 4, gl.UNSIGNED_SHORT, true, 8 * checker.frame * pane.count);
      gl.uniform4f(U.cells, ...checker.low, checker.scale);
    } else attribute(5, null);
    gl.uniform1i(U.kind, pane.measured ? 2 : pane.colors ? 1 : 0);
    gl.uniform3f(U.plain, 0.76, 0.78, 0.82);
    // A number's colour is the bar's, not a shade of it.
    gl.uniform1i(U.shading, pane.measured ? 2 : $("smooth").checked ? 1 : 0);
    const wire = $("wire").checked;
    if (wire) gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, pane.faces);
    gl.drawElements(gl.TRIANGLES, pane.triangles.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (wire) {
      if (!pane.lines) {
        const lines = edges(pane.triangles, pane.count);
        Object.assign(pane, { lines: buffer(lines, gl.ELEMENT_ARRAY_BUFFER), ends: lines.length });
      }
      gl.uniform1i(U.kind, 0);
      gl.uniform1i(U.shading, 2);
      gl.uniform3f(U.plain, 0.23, 0.26, 0.31);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, pane.lines);
      // Through edges that lie close together the colours are still to be seen.
      gl.enable(gl.BLEND);
      gl.drawElements(gl.LINES, pane.ends, gl.UNSIGNED_INT, 0);
      gl.disable(gl.BLEND);
    }
  }
  if (pane.cloud && (!pane.faces || $("cloud").checked)) {
    gl.uniform1f(U.mixing, 0);
    const t = Math.min(Math.round(at), S.frames - 1);
    for (const i of [0, 1]) attribute(i, pane.cloud, 4, gl.UNSIGNED_SHORT, true, 8 * pane.cloudStarts[t]);
    for (const i of [2, 3, 4, 5]) attribute(i, null);
    gl.uniform1i(U.kind, 0);
    gl.uniform1i(U.shading, 3);
    gl.uniform3f(U.plain, 0.27, 0.34, 0.42);
    gl.uniform1f(U.pixel, scale);
    gl.uniform1f(U.pointScale, 0.7 * S.spacing * height / (2 * opening));
    gl.drawArrays(gl.POINTS, 0, pane.cloudCounts[t]);
  }
}
function draw() {
  const canvas = $("canvas"), scale = window.devicePixelRatio || 1;
  const w = Math.max(1, Math.round(canvas.clientWidth * scale));
  const h = Math.max(1, Math.round(canvas.clientHeight * scale));
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const width = Math.floor(tiles.width * scale), height = Math.floor(tiles.height * scale);
  panes.forEach((pane, i) => {
    const [left, top] = tiles.places[i].map(c => Math.round(c * scale));
    drawPane(pane, left, h - top - height, width, height, scale);
  });
  const frame = Math.min(Math.round(at), S.frames - 1);
  $("slider").value = frame;
  $("name").textContent = `frame ${frame} (0 to ${S.frames - 1}): ${S.names[frame]}`;
  root.frame = frame;
  root.drawn = ++drawn;
}
"""
    + CONTROLS_SCRIPT
)
