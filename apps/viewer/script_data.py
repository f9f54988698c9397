"""The first part of the web page's script: what ``viewer/page_data.py`` packed, unpacked once; normals and edges."""

DATA_SCRIPT = r""""use strict";
const root = document.documentElement.dataset, $ = id => document.getElementById(id);
function say(text) { $("message").textContent = text; $("message").hidden = !text; }
function fail(text) { root.error = text; say(text); }
window.addEventListener("error", e => fail(e.message));
window.addEventListener("unhandledrejection", e => fail(String(e.reason && e.reason.message || e.reason)));
const S = JSON.parse($("scene").textContent);

// Long work lets the page live: it waits where a twentieth of a second has passed, and says how far it is.
let waited = performance.now();
async function breathe(share) {
  if (performance.now() - waited < 50) return;
  say(`unpacking ${S.frames} frames: ${Math.round(100 * share)} %`);
  await new Promise(resolve => setTimeout(resolve));
  waited = performance.now();
}

function bytes(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}
async function inflate(text) {
  if (!window.DecompressionStream) throw new Error("This page needs a browser of 2023 or later.");
  const given = bytes(text), parts = [];
  const stream = new ReadableStream({ start(c) { c.enqueue(given); c.close(); } });
  const reader = stream.pipeThrough(new DecompressionStream("deflate")).getReader();
  let total = 0;
  for (let part; !(part = await reader.read()).done;) { parts.push(part.value); total += part.value.length; }
  const out = new Uint8Array(total);
  let at = 0;
  for (const part of parts) { out.set(part, at); at += part.length; }
  return out;
}
const unfold = k => (k >>> 1) ^ -(k & 1);

// Numbers (frames, count, columns) of one or two bytes into rows of four 16-bit numbers, from a column on.
async function moving(text, frames, count, columns, width, parents, rows, column) {
  const raw = await inflate(text), half = frames * columns * count, mask = width === 2 ? 65535 : 255;
  const change = new Int32Array(count);
  for (let t = 0; t < frames; t++) {
    for (let c = 0; c < columns; c++) {
      const from = (t * columns + c) * count;
      for (let v = 0; v < count; v++) {
        const k = from + v, folded = width === 2 ? raw[k] | raw[half + k] << 8 : raw[k];
        change[v] = unfold(folded) + (v ? change[parents[v]] : 0);
        const to = 4 * (t * count + v) + column + c;
        rows[to] = change[v] + (t ? rows[to - 4 * count] : 0) & mask;
      }
    }
    await breathe(0.4 * t / frames);
  }
}
async function indices(text) {
  const raw = await inflate(text), n = raw.length / 4, out = new Uint32Array(n);
  for (let i = 0, last = 0; i < n; i++)
    out[i] = last = last + unfold(raw[i] | raw[n + i] << 8 | raw[2 * n + i] << 16 | raw[3 * n + i] << 24);
  return out;
}
function lowerNeighbours(faces, count) {
  const found = new Int32Array(count).fill(-1);
  for (let i = 0; i < faces.length; i++) {
    const a = faces[i], b = faces[i % 3 === 2 ? i - 2 : i + 1], low = Math.min(a, b), high = Math.max(a, b);
    if (low < high && low > found[high]) found[high] = low;
  }
  for (let v = 0; v < count; v++) if (found[v] < 0) found[v] = v - 1;
  return found;
}

// Vertex normals of every frame, four bytes each, once at the start.
async function normals(rows, faces, count) {
  const out = new Int8Array(S.frames * count * 4), sum = new Float32Array(count * 3), s = S.size;
  for (let t = 0; t < S.frames; t++) {
    sum.fill(0);
    const at = t * count * 4;
    for (let i = 0; i < faces.length; i += 3) {
      const a = faces[i], b = faces[i + 1], c = faces[i + 2];
      const p = at + 4 * a, q = at + 4 * b, r = at + 4 * c;
      const ux = (rows[q] - rows[p]) * s[0], vx = (rows[r] - rows[p]) * s[0];
      const uy = (rows[q + 1] - rows[p + 1]) * s[1], vy = (rows[r + 1] - rows[p + 1]) * s[1];
      const uz = (rows[q + 2] - rows[p + 2]) * s[2], vz = (rows[r + 2] - rows[p + 2]) * s[2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      sum[3 * a] += x; sum[3 * a + 1] += y; sum[3 * a + 2] += z;
      sum[3 * b] += x; sum[3 * b + 1] += y; sum[3 * b + 2] += z;
      sum[3 * c] += x; sum[3 * c + 1] += y; sum[3 * c + 2] += z;
    }
    for (let k = 0; k < count; k++) {
      const x = sum[3 * k], y = sum[3 * k + 1], z = sum[3 * k + 2], o = at + 4 * k;
      const l = 127 / (Math.sqrt(x * x + y * y + z * z) || 1);
      out[o] = Math.round(x * l); out[o + 1] = Math.round(y * l); out[o + 2] = Math.round(z * l);
    }
    await breathe(0.4 + 0.6 * t / S.frames);
  }
  return out;
}
function edges(faces, count) {
  const seen = new Set(), lines = [];
  for (let i = 0; i < faces.length; i++) {
    const a = faces[i], b = faces[i % 3 === 2 ? i - 2 : i + 1], key = Math.min(a, b) * count + Math.max(a, b);
    if (!seen.has(key)) { seen.add(key); lines.push(a, b); }
  }
  return new Uint32Array(lines);
}
"""
