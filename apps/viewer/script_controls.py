"""The last part of the web page's script: what is pressed, dragged and turned, the colour bar, and the start."""

CONTROLS_SCRIPT = r"""
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

async function showBar(pane) {
  const ramp = $("ramp").getContext("2d"), image = ramp.createImageData(255, 1), table = await inflate(pane.table);
  for (let i = 0; i < 255; i++) image.data.set([table[3 * i], table[3 * i + 1], table[3 * i + 2], 255], 4 * i);
  ramp.putImageData(image, 0, 0);
  $("label").textContent = pane.label;
  for (const share of [0, 0.25, 0.5, 0.75, 1]) {
    const value = pane.limits[0] + share * (pane.limits[1] - pane.limits[0]);
    const text = document.createElement("span");
    text.textContent = Number(value.toPrecision(3));
    text.style.left = `${100 * share}%`;
    $("ticks").append(text);
  }
  $("ends").textContent = pane.ends;
  $("bar").hidden = false;
}
function dragging(canvas) {
  const held = new Map();
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
      const [r, u] = axesOf(cam.a, cam.e), step = 2 * cam.d * opening / tiles.height;
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
    cam.d = Math.max(cam.usual / 100, Math.min(cam.usual * 10, cam.d * Math.exp(e.deltaY * 0.001)));
    cam.home = false;
    dirty = true;
  }, { passive: false });
}

async function start() {
  gl.clearColor(1, 1, 1, 1);
  gl.enable(gl.DEPTH_TEST);
  gl.polygonOffset(1, 1);
  gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
  gl.blendColor(0, 0, 0, 0.35);
  const P = program();
  gl.useProgram(P);
  U = {};
  const names = ["view", "low", "size", "mixing", "pointScale", "pixel", "kind", "toEye", "above", "shading", "plain"];
  names.push("cells", "dark");
  for (const name of names) U[name] = gl.getUniformLocation(P, name);
  gl.uniform3fv(U.low, S.low);
  gl.uniform3fv(U.size, S.size);
  for (const pane of S.panes) panes.push(await prepare(pane));
  outline = Float32Array.from(panes.flatMap(pane => pane.outline));
  for (const pane of panes)
    $("titles").append(Object.assign(document.createElement("div"), { textContent: pane.title }));
  $("slider").max = S.frames - 1;
  $("smooth").checked = S.smooth;
  $("wire").checked = S.wireframe;
  $("cloud").checked = S.cloud;
  $("cloudLabel").hidden = !panes.some(pane => pane.cloud && pane.faces);
  const measured = S.panes.find(pane => pane.values);
  if (measured) await showBar(measured);
  $("play").onclick = () => play(!playing);
  $("home").onclick = KEYS.r;
  $("slider").oninput = () => go(Number($("slider").value));
  for (const id of ["wire", "smooth", "cloud", "blend"]) $(id).onchange = () => { dirty = true; };
  new ResizeObserver(arrange).observe($("canvas"));  // rows of controls come and go, too
  // A control that was clicked must not take the keys; the select keeps them while it is open.
  document.querySelectorAll("button, input").forEach(e => e.addEventListener("change", () => e.blur()));
  document.querySelectorAll("button").forEach(e => e.addEventListener("click", () => e.blur()));
  window.addEventListener("keydown", e => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === "SELECT") return;
    const action = KEYS[e.key] || KEYS[e.key.toLowerCase()];
    if (action) { e.preventDefault(); action(); }
  });
  dragging($("canvas"));
  say("");
  arrange();
  draw();
  play(true);
  last = performance.now();
  root.ready = "1";
  root.seconds = (last / 1000).toFixed(2);
  requestAnimationFrame(tick);
}
const started = gl ? start() : Promise.resolve();
"""
