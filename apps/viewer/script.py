"""The script of the web page of ``viewer/html.py``: WebGL 2 and nothing else; one buffer holds all frames."""

SCRIPT = r""""use strict";
const root = document.documentElement.dataset, $ = id => document.getElementById(id);
window.addEventListener("error", e => { root.error = e.message; say(e.message); });
function say(text) { $("message").textContent = text; $("message").hidden = false; }
const S = JSON.parse($("scene").textContent);

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}
const shorts = text => new Uint16Array(bytes(text).buffer);

// Camera: angles about the focus; "up" is y or z of the data.
const frameOf = S.up === "z" ? v => [v[0], -v[2], v[1]] : v => v;
const opening = Math.tan(S.angle * Math.PI / 360);
function usual() {
  const [x, y, z] = S.extent, aspect = $("canvas").clientWidth / S.panes.length / $("canvas").clientHeight || 1;
  const d = z + Math.max(y / opening, x / (opening * aspect)) * S.margin;
  return { a: S.azimuth * Math.PI / 180, e: S.elevation * Math.PI / 180, d, f: S.focus.slice(), home: true };
}
let cam = usual();
function axes() {
  const ca = Math.cos(cam.a), sa = Math.sin(cam.a), ce = Math.cos(cam.e), se = Math.sin(cam.e);
  return [[ca, 0, -sa], [-sa * se, ce, -ca * se], [sa * ce, se, ca * ce]].map(frameOf);
}
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
function matrices(aspect) {
  const [r, u, b] = axes(), eye = cam.f.map((c, i) => c + cam.d * b[i]);
  const f = 1 / opening, reach = Math.hypot(...S.size) + cam.d;
  const near = Math.max(cam.d / 200, cam.d - Math.hypot(...S.size) * 1.5), far = reach * 1.5;
  const fx = f / aspect, fy = f;
  const A = (near + far) / (near - far), B = 2 * near * far / (near - far);
  const row = (v, s) => [s * v[0], s * v[1], s * v[2], -s * dot(v, eye)];
  const X = row(r, fx), Y = row(u, fy), Z = row(b, A), W = row(b, -1);
  Z[3] += B;
  const m = new Float32Array(16);
  for (let i = 0; i < 4; i++) { m[4 * i] = X[i]; m[4 * i + 1] = Y[i]; m[4 * i + 2] = Z[i]; m[4 * i + 3] = W[i]; }
  return [m, b, u];
}

const gl = $("canvas").getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
if (!gl) { say("This page needs WebGL 2, which this browser does not offer."); root.error = "no WebGL 2"; }

const VERTEX = `#version 300 es
in vec3 p0; in vec3 p1; in vec3 n0; in vec3 n1; in vec3 color; in float value0; in float value1;
uniform mat4 view; uniform vec3 low, size; uniform float mixing, pointSize; uniform int kind; uniform sampler2D table;
out vec3 tint, normal, place;
void main() {
  place = low + size * mix(p0, p1, mixing);
  normal = mix(n0, n1, mixing);
  tint = color;
  if (kind == 2) {
    float v = value0 > 254.5 || value1 > 254.5 ? 255.0 : mix(value0, value1, mixing);
    tint = texture(table, vec2((v + 0.5) / 256.0, 0.5)).rgb;
  }
  gl_Position = view * vec4(place, 1.0);
  gl_PointSize = pointSize;
}`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in vec3 tint, normal, place; uniform vec3 toEye, above; uniform int shading; uniform vec3 plain; uniform int kind;
out vec4 result;
void main() {
  vec3 base = kind == 0 ? plain : tint;
  if (shading == 2) { result = vec4(base, 1.0); return; }
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
  ["p0", "p1", "n0", "n1", "color", "value0", "value1"].forEach((name, i) => gl.bindAttribLocation(made, i, name));
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

// Vertex normals of every frame, four bytes each, once at the start.
function normals(positions, faces, count) {
  const out = new Int8Array(S.frames * count * 4), sum = new Float32Array(count * 3), s = S.size;
  for (let t = 0; t < S.frames; t++) {
    sum.fill(0);
    const at = t * count * 3;
    for (let i = 0; i < faces.length; i += 3) {
      const a = 3 * faces[i], b = 3 * faces[i + 1], c = 3 * faces[i + 2];
      const ux = (positions[at + b] - positions[at + a]) * s[0], vx = (positions[at + c] - positions[at + a]) * s[0];
      const uy = (positions[at + b + 1] - positions[at + a + 1]) * s[1];
      const vy = (positions[at + c + 1] - positions[at + a + 1]) * s[1];
      const uz = (positions[at + b + 2] - positions[at + a + 2]) * s[2];
      const vz = (positions[at + c + 2] - positions[at + a + 2]) * s[2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const k of [a, b, c]) { sum[k] += x; sum[k + 1] += y; sum[k + 2] += z; }
    }
    for (let k = 0; k < count; k++) {
      const l = 127 / (Math.hypot(sum[3 * k], sum[3 * k + 1], sum[3 * k + 2]) || 1), o = 4 * (t * count + k);
      for (let i = 0; i < 3; i++) out[o + i] = Math.round(sum[3 * k + i] * l);
    }
  }
  return out;
}

function texture(pixels) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, pixels.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, pixels);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  return made;
}

function prepare(pane) {
  const made = { title: pane.title, table: texture(pane.table ? bytes(pane.table) : new Uint8Array(3)) };
  if (pane.faces) {
    const faces = new Uint32Array(bytes(pane.faces).buffer), positions = shorts(pane.positions);
    const seen = new Set(), lines = [];
    for (let i = 0; i < faces.length; i++) {
      const a = faces[i], b = faces[i % 3 === 2 ? i - 2 : i + 1], key = Math.min(a, b) * pane.count + Math.max(a, b);
      if (!seen.has(key)) { seen.add(key); lines.push(a, b); }
    }
    Object.assign(made, { count: pane.count, corners: faces.length, ends: lines.length });
    made.positions = buffer(positions, gl.ARRAY_BUFFER);
    made.normals = buffer(normals(positions, faces, pane.count), gl.ARRAY_BUFFER);
    made.faces = buffer(faces, gl.ELEMENT_ARRAY_BUFFER);
    made.lines = buffer(new Uint32Array(lines), gl.ELEMENT_ARRAY_BUFFER);
    if (pane.colors) made.colors = buffer(bytes(pane.colors), gl.ARRAY_BUFFER);
    if (pane.values) made.values = buffer(bytes(pane.values), gl.ARRAY_BUFFER);
  }
  if (pane.cloud) {
    made.cloud = buffer(shorts(pane.cloud), gl.ARRAY_BUFFER);
    made.cloudCounts = pane.cloudCounts;
    made.cloudStarts = pane.cloudCounts.map((_, i) => pane.cloudCounts.slice(0, i).reduce((a, b) => a + b, 0));
  }
  return made;
}

let P, U, panes = [], dirty = true, playing = false, at = S.frame, last = 0, drawn = 0;
function attribute(index, source, size, kind, normalized, stride, offset) {
  if (!source) { gl.disableVertexAttribArray(index); return; }
  gl.bindBuffer(gl.ARRAY_BUFFER, source);
  gl.enableVertexAttribArray(index);
  gl.vertexAttribPointer(index, size, kind, normalized, stride, offset);
}
function drawPane(pane, x, width, height) {
  gl.viewport(x, 0, width, height);
  const [view, toEye, above] = matrices(width / height);
  gl.uniformMatrix4fv(U.view, false, view);
  gl.uniform3fv(U.toEye, toEye);
  gl.uniform3fv(U.above, above);
  gl.bindTexture(gl.TEXTURE_2D, pane.table);
  const now = Math.floor(at), next = Math.min(now + 1, S.frames - 1), mixing = $("blend").checked ? at - now : 0;
  if (pane.faces) {
    gl.uniform1f(U.mixing, mixing);
    [now, next].forEach((t, i) => {
      attribute(i, pane.positions, 3, gl.UNSIGNED_SHORT, true, 6, 6 * t * pane.count);
      attribute(2 + i, pane.normals, 3, gl.BYTE, true, 4, 4 * t * pane.count);
      attribute(5 + i, pane.values, 1, gl.UNSIGNED_BYTE, false, 1, t * pane.count);
    });
    attribute(4, pane.colors, 3, gl.UNSIGNED_BYTE, true, 3, 0);
    gl.uniform1i(U.kind, pane.values ? 2 : pane.colors ? 1 : 0);
    gl.uniform3f(U.plain, 0.76, 0.78, 0.82);
    const wire = $("wire").checked;
    gl.uniform1i(U.shading, wire ? 2 : $("smooth").checked ? 1 : 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, wire ? pane.lines : pane.faces);
    gl.drawElements(wire ? gl.LINES : gl.TRIANGLES, wire ? pane.ends : pane.corners, gl.UNSIGNED_INT, 0);
  }
  if (pane.cloud && (!pane.faces || $("cloud").checked)) {
    gl.uniform1f(U.mixing, 0);
    const t = Math.min(Math.round(at), S.frames - 1);
    for (const i of [0, 1]) attribute(i, pane.cloud, 3, gl.UNSIGNED_SHORT, true, 6, 6 * pane.cloudStarts[t]);
    for (const i of [2, 3, 4, 5, 6]) attribute(i, null);
    gl.uniform1i(U.kind, 0);
    gl.uniform1i(U.shading, 2);
    gl.uniform3f(U.plain, 0.82, 0.29, 0.36);
    gl.uniform1f(U.pointSize, 2.5 * (window.devicePixelRatio || 1));
    gl.drawArrays(gl.POINTS, 0, pane.cloudCounts[t]);
  }
}
function draw() {
  const canvas = $("canvas"), scale = window.devicePixelRatio || 1;
  const w = Math.max(1, Math.round(canvas.clientWidth * scale));
  const h = Math.max(1, Math.round(canvas.clientHeight * scale));
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const width = Math.floor(w / panes.length);
  panes.forEach((pane, i) => drawPane(pane, i * width, width, h));
  const frame = Math.min(Math.round(at), S.frames - 1);
  $("slider").value = frame;
  $("name").textContent = `${frame}: ${S.names[frame]}`;
  root.frame = frame;
  root.drawn = ++drawn;
}
function tick(now) {
  if (playing) {
    // A page that slept goes on where it was; the first time stamp may lie before the start.
    at += Math.max(0, Math.min(now - last, 250)) / 1000 * S.fps * Number($("speed").value);
    const end = S.frames - ($("loop").checked ? 0 : 1);
    if (at >= end) { if ($("loop").checked) at %= S.frames; else { at = end; play(false); } }
    dirty = true;
  }
  last = now;
  if (dirty) { dirty = false; draw(); }
  requestAnimationFrame(tick);
}
function play(on) {
  if (on && !$("loop").checked && at >= S.frames - 1) at = 0;
  playing = on && S.frames > 1;
  $("play").textContent = playing ? "pause" : "play";
}
function go(frame) { play(false); at = Math.max(0, Math.min(S.frames - 1, frame)); dirty = true; }
const flip = id => { $(id).checked = !$(id).checked; dirty = true; };
const KEYS = {
  " ": () => play(!playing), ArrowRight: () => go((Math.round(at) + 1) % S.frames),
  ArrowLeft: () => go((Math.round(at) + S.frames - 1) % S.frames), Home: () => go(0), End: () => go(S.frames - 1),
  ArrowUp: () => faster(1), ArrowDown: () => faster(-1), l: () => flip("loop"), p: () => flip("cloud"),
  w: () => flip("wire"), s: () => flip("smooth"), r: () => { cam = usual(); dirty = true; },
};
function faster(by) {
  const s = $("speed");
  s.selectedIndex = Math.max(0, Math.min(s.options.length - 1, s.selectedIndex + by));
}

function start() {
  gl.clearColor(1, 1, 1, 1);
  gl.enable(gl.DEPTH_TEST);
  P = program();
  gl.useProgram(P);
  U = {};
  for (const name of ["view", "low", "size", "mixing", "pointSize", "kind", "toEye", "above", "shading", "plain"])
    U[name] = gl.getUniformLocation(P, name);
  gl.uniform3fv(U.low, S.low);
  gl.uniform3fv(U.size, S.size);
  gl.uniform1f(U.pointSize, 3);
  panes = S.panes.map(prepare);
  for (const pane of panes)
    $("titles").append(Object.assign(document.createElement("div"), { textContent: pane.title }));
  $("slider").max = S.frames - 1;
  $("smooth").checked = S.smooth;
  $("wire").checked = S.wireframe;
  $("cloud").checked = S.cloud;
  $("cloudLabel").hidden = !panes.some(pane => pane.cloud && pane.faces);
  const measured = S.panes.find(pane => pane.values);
  if (measured) {
    const ramp = $("ramp").getContext("2d"), image = ramp.createImageData(255, 1), table = bytes(measured.table);
    for (let i = 0; i < 255; i++) image.data.set([table[3 * i], table[3 * i + 1], table[3 * i + 2], 255], 4 * i);
    ramp.putImageData(image, 0, 0);
    $("label").textContent = measured.label;
    $("least").textContent = measured.limits[0].toPrecision(3);
    $("most").textContent = measured.limits[1].toPrecision(3);
    $("bar").hidden = false;
  }
  $("play").onclick = () => play(!playing);
  $("home").onclick = KEYS.r;
  $("slider").oninput = () => go(Number($("slider").value));
  for (const id of ["wire", "smooth", "cloud", "blend"]) $(id).onchange = () => { dirty = true; };
  window.onresize = () => { if (cam.home) cam = usual(); dirty = true; };
  // A control that was clicked must not take the keys; the select keeps them while it is open.
  document.querySelectorAll("button, input").forEach(e => e.addEventListener("change", () => e.blur()));
  document.querySelectorAll("button").forEach(e => e.addEventListener("click", () => e.blur()));
  window.addEventListener("keydown", e => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === "SELECT") return;
    const action = KEYS[e.key] || KEYS[e.key.toLowerCase()];
    if (action) { e.preventDefault(); action(); }
  });
  const canvas = $("canvas"), held = new Map();
  canvas.onpointerdown = e => { canvas.setPointerCapture(e.pointerId); held.set(e.pointerId, e); };
  canvas.onpointerup = canvas.onpointercancel = e => held.delete(e.pointerId);
  canvas.onpointermove = e => {
    const before = held.get(e.pointerId);
    if (!before) return;
    cam.home = false;
    const dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
    if (held.size === 2) {
      const other = [...held.values()].find(o => o.pointerId !== e.pointerId), far = o =>
        Math.hypot(o.clientX - other.clientX, o.clientY - other.clientY) || 1;
      cam.d *= far(before) / far(e);
    } else if (e.shiftKey || before.button === 2 || before.button === 1) {
      const [r, u] = axes(), step = 2 * cam.d * opening / canvas.clientHeight;
      cam.f = cam.f.map((c, i) => c - step * dx * r[i] + step * dy * u[i]);
    } else {
      cam.a -= dx * 0.008;
      cam.e = Math.max(-1.55, Math.min(1.55, cam.e + dy * 0.008));
    }
    held.set(e.pointerId, { pointerId: e.pointerId, clientX: e.clientX, clientY: e.clientY, button: before.button });
    dirty = true;
  };
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.addEventListener("wheel", e => {
    e.preventDefault();
    cam.d = Math.max(usual().d / 100, Math.min(usual().d * 10, cam.d * Math.exp(e.deltaY * 0.001)));
    cam.home = false;
    dirty = true;
  }, { passive: false });
  draw();
  play(true);
  last = performance.now();
  root.ready = "1";
  requestAnimationFrame(tick);
}
if (gl) start();
"""
