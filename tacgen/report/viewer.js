// Draws what tacgen/report/viewer.py wrote into #viewed: maps and curves on 2D canvases, the gel by WebGL 2.
"use strict";
(() => {
const data = JSON.parse(document.getElementById("viewed").textContent), root = document.querySelector(".viewer");
const SIZE = [560, 370], FORCE = [560, 150], GAP = 12, LEAST = 420, PLOT = { left: 52, top: 10, right: 92, bottom: 40 }, SHARP = 2;
const AROUND = 18; // pixels of a card's padding and border
const tone = (name) => getComputedStyle(root).getPropertyValue(`--${name}`); // a colour of page.css
const state = { k: 0, layer: data.layers[0] ?? "picture", part: 0, cut: true, indenter: true, turn: [-0.5, 0.45], zoom: 1 };
const most = Math.max(...data.bundles.map((b) => b.frames.length));
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const floats = (text) => new Float32Array(bytes(text).buffer), numbers = (text) => new Uint32Array(bytes(text).buffer);
const tables = Object.fromEntries(Object.entries(data.colours).map(([name, text]) => [name, bytes(text)]));
const short = (x) => String(+x.toPrecision(3)).replace("-", "\u2212");
const fixed = (x, digits) => (+x.toFixed(digits) || 0).toFixed(digits).replace("-", "\u2212"); // never -0.00

function make(kind, parent, set = {}) {
  const made = Object.assign(document.createElement(kind), set);
  parent.append(made);
  return made;
}

function ticks(low, high, count) {
  const rough = (high - low) / count, ten = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((n) => n * ten >= rough) * ten, found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found;
}

function sharp(canvas, [width, height]) { // a cleared 2D context in CSS pixels
  [canvas.width, canvas.height] = [SHARP * width, SHARP * height];
  const pen = canvas.getContext("2d");
  pen.scale(SHARP, SHARP);
  pen.font = "11px system-ui, sans-serif";
  return pen;
}

function write(pen, text, x, y, align = "center", turned = 0) {
  pen.save();
  pen.translate(x, y);
  pen.rotate(turned);
  Object.assign(pen, { fillStyle: tone("ink"), textAlign: align, textBaseline: "middle" }).fillText(text, 0, 0);
  pen.restore();
}

function line(pen, colour, width, ...points) {
  Object.assign(pen, { strokeStyle: colour, lineWidth: width });
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

function arrow(pen, x, y, u, v) {
  const length = Math.hypot(u, v), head = Math.min(6, 0.5 * length), [c, s] = [u / length, v / length];
  if (length < 2) return;
  const wing = (side) => [x + u - head * (c + side * 0.5 * s), y + v - head * (s - side * 0.5 * c)];
  for (const [colour, width] of [["#000", 2.6], ["#fff", 1.3]]) line(pen, colour, width, [x, y], [x + u, y + v], wing(1), [x + u, y + v], wing(-1));
}

function bar(pen, scale, x, y, height) {
  const table = tables[scale.colours], at = (value) => y + height * (1 - (value - scale.low) / (scale.high - scale.low));
  for (let i = 0; i < 255; i++) {
    pen.fillStyle = `rgb(${table.slice(3 * i, 3 * i + 3).join()})`;
    pen.fillRect(x, y + height * (1 - (i + 1) / 255), 12, height / 255 + 0.5);
  }
  for (const value of ticks(scale.low, scale.high, 6)) {
    line(pen, tone("ink"), 1, [x + 12, at(value)], [x + 16, at(value)]);
    write(pen, short(value), x + 19, at(value), "left");
  }
  write(pen, scale.label, x + 66, y + height / 2, "center", -Math.PI / 2);
}

const kept = new Map(); // pictures that were unpacked: a canvas, and of a map its levels
async function picture(side, name, k) {
  const key = `${side.number} ${name} ${k}`, layer = side.bundle.layers[name];
  if (kept.has(key)) return kept.get(key);
  const image = new Image();
  image.src = `data:image/${layer.kind};base64,${layer.pictures[k]}`;
  await image.decode();
  const canvas = document.createElement("canvas"), found = { canvas, levels: null };
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  pen.drawImage(image, 0, 0);
  if (data.scales[name]) {
    const pixels = pen.getImageData(0, 0, canvas.width, canvas.height), table = tables[data.scales[name].colours];
    found.levels = Uint8Array.from({ length: canvas.width * canvas.height }, (_, i) => pixels.data[4 * i]);
    found.levels.forEach((level, i) => pixels.data.set(level ? [...table.subarray(3 * level - 3, 3 * level), 255] : [0, 0, 0, 0], 4 * i));
    pen.putImageData(pixels, 0, 0);
  }
  kept.set(key, found);
  return found;
}

async function drawMap(side, name, k) {
  const layer = side.bundle.layers[name], [x0, y0, x1, y1] = side.bundle.box, scale = data.scales[name];
  const source = layer?.pictures ? name : name === "markers" && side.bundle.layers.camera ? "camera" : "";
  const shown = source ? await picture(side, source, k) : null;
  if (k !== place(side) || name !== state.layer) return; // another frame was asked for meanwhile
  const pen = sharp(side.canvas, SIZE), aspect = (y1 - y0) / (x1 - x0);
  const width = Math.min(SIZE[0] - PLOT.left - PLOT.right, (SIZE[1] - PLOT.top - PLOT.bottom) / aspect), height = width * aspect;
  const left = PLOT.left + (SIZE[0] - PLOT.left - PLOT.right - width) / 2;
  side.shown = { ...shown, left, width, height, scale };
  if (!layer) return write(pen, `no ${name} in this bundle`, SIZE[0] / 2, 60);
  pen.imageSmoothingEnabled = !scale;
  if (shown) pen.drawImage(shown.canvas, left, PLOT.top, width, height);
  layer.arrows?.at.forEach(([x, y], i) => {
    const [u, v] = layer.arrows.by[k][i];
    arrow(pen, left + x * width, PLOT.top + y * height, u * width, v * width);
  });
  line(pen, tone("soft"), 1, ...[[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]].map(([x, y]) => [left + x * width, PLOT.top + y * height]));
  for (const x of ticks(x0, x1, 6)) {
    const at = left + ((x - x0) / (x1 - x0)) * width;
    line(pen, tone("ink"), 1, [at, PLOT.top + height], [at, PLOT.top + height + 4]);
    write(pen, short(x), at, PLOT.top + height + 11);
  }
  for (const y of ticks(y0, y1, 5)) {
    const at = PLOT.top + ((y - y0) / (y1 - y0)) * height;
    line(pen, tone("ink"), 1, [left - 4, at], [left, at]);
    write(pen, short(y), left - 7, at, "right");
  }
  const arrows = name === "markers" ? `; arrows: motion of the markers \u00d7 ${data.magnified}` : "";
  write(pen, `x [${side.bundle.unit}]${arrows}`, left + width / 2, PLOT.top + height + 27);
  write(pen, `y [${side.bundle.unit}]`, left - 40, PLOT.top + height / 2, "center", -Math.PI / 2);
  if (scale) bar(pen, scale, left + width + 8, PLOT.top, height);
}

const VERTEX = `#version 300 es
in vec3 point; in float level; uniform mat4 pose, view; out vec3 at; out float value;
void main() { vec4 moved = pose * vec4(point, 1.0); at = moved.xyz; value = level; gl_Position = view * moved; }`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 at; in float value; uniform sampler2D colours; uniform vec4 plain; uniform float cut, depth, shade; out vec4 colour;
void main() {
  if (at.y < cut) discard;
  gl_FragDepth = gl_FragCoord.z + depth;
  float light = 1.0 - shade * (1.0 - abs(normalize(cross(dFdx(at), dFdy(at))).z));
  vec3 own = plain.a > 0.0 ? plain.rgb : texture(colours, vec2((value * 255.0 - 0.5) / 255.0, 0.5)).rgb;
  colour = vec4(shade > 0.0 ? own * light : own, 1.0);
}`;
const UNIT = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

class Solid {
  constructor(canvas, told) {
    [this.canvas, this.told] = [canvas, told];
    this.resize();
    const gl = (this.gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true }));
    if (!gl) return;
    this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    ["point", "level"].forEach((name, i) => gl.bindAttribLocation(this.program, i, name));
    gl.linkProgram(this.program);
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of ["MIN", "MAG"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}_FILTER`], gl.LINEAR);
    for (const name of ["S", "T"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_WRAP_${name}`], gl.CLAMP_TO_EDGE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.buffers = ["point", "level", "order"].map(() => gl.createBuffer());
    [this.faces, this.rims] = [numbers(told.faces), numbers(told.rims)];
    const rest = floats(told.points[0]), ends = (axis) => rest.filter((_, i) => i % 3 === axis).reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    this.ends = [0, 1, 2].map(ends);
    if (told.indenter) { // is seen whole
      const top = floats(told.indenter.points).reduce((most, v, i) => (i % 3 === 2 ? Math.max(most, v) : most), -Infinity);
      this.ends[2][1] = Math.max(this.ends[2][1], told.poses[0][14] + top);
    }
    this.scale = 2.2 / Math.hypot(...this.ends.map(([a, b]) => b - a));
  }

  resize() { [this.canvas.width, this.canvas.height] = SIZE.map((n) => SHARP * n); }

  uniform(kind, name, ...values) { this.gl[`uniform${kind}`](this.gl.getUniformLocation(this.program, name), ...values); }

  mesh(kind, points, levels, shade, order) { // `levels` may be a colour
    const gl = this.gl, [at, value, numbered] = this.buffers, coloured = levels instanceof Uint8Array;
    this.uniform("4fv", "plain", coloured ? [0, 0, 0, 0] : [...levels, 1]);
    this.uniform("1f", "shade", shade);
    gl.bindBuffer(gl.ARRAY_BUFFER, at);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.disableVertexAttribArray(1);
    if (coloured) {
      gl.bindBuffer(gl.ARRAY_BUFFER, value);
      gl.bufferData(gl.ARRAY_BUFFER, levels, gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 1, gl.UNSIGNED_BYTE, true, 0, 0);
    }
    if (!order) return gl.drawArrays(kind, 0, points.length / 3);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, numbered);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    gl.drawElements(kind, order.length, gl.UNSIGNED_INT, 0);
  }

  size() { return this.scale * state.zoom * Math.min(1, SIZE[0] / SIZE[1] / 1.5); } // a canvas is as high as 2 / size [mm]

  axes() { // screen x, screen y and depth of the sensor's x, y and z
    const [[c, s], [d, e]] = state.turn.map((angle) => [Math.cos(angle), Math.sin(angle)]);
    return [[c, e * s, d * s], [-s, e * c, d * c], [0, d, -e]];
  }

  draw(k) {
    const { gl, told } = this, part = data.parts[state.part], axes = this.axes(), size = this.size();
    const wide = (size * SIZE[1]) / SIZE[0], middle = this.ends.map(([a, b]) => (a + b) / 2), cut = state.cut ? told.cuts[k].y : -1e9;
    const view = axes.flatMap(([x, y, z]) => [wide * x, size * y, 0.2 * this.scale * z, 0]);
    view.push(...[0, 1, 2].map((i) => -middle.reduce((sum, m, j) => sum + m * view[4 * j + i], 0)), 1);
    view[12] -= 0.12; // beside the colour bar
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...[1, 3, 5].map((i) => parseInt(tone("card").trim().slice(i, i + 2), 16) / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 255, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, tables[part.colours]);
    this.uniform("Matrix4fv", "view", false, view);
    this.uniform("Matrix4fv", "pose", false, UNIT);
    this.uniform("1f", "cut", cut - 1e-4);
    this.uniform("1f", "depth", 0);
    const points = floats(told.points[k]), levels = bytes(told.values[k][state.part]);
    this.mesh(gl.TRIANGLES, points, levels, 0.25, this.faces);
    if (state.cut) this.mesh(gl.TRIANGLES, floats(told.cuts[k].points), bytes(told.cuts[k].values[state.part]), 0);
    this.uniform("1f", "depth", -3e-4);
    this.mesh(gl.LINES, points, [0.25, 0.25, 0.25], 0, this.rims);
    this.uniform("1f", "depth", 0);
    if (state.indenter && told.indenter) {
      this.uniform("Matrix4fv", "pose", false, told.poses[k]);
      this.mesh(gl.TRIANGLES, floats(told.indenter.points), [0.72, 0.74, 0.78], 0.4, numbers(told.indenter.faces));
    }
  }
}

function drawSolid(side, k) {
  const pen = sharp(side.canvas, SIZE), { solid } = side;
  if (!solid) return write(pen, "no stress in this bundle", SIZE[0] / 2, 60);
  if (!solid.gl) return write(pen, "this browser has no WebGL 2", SIZE[0] / 2, 60);
  solid.draw(k);
  pen.fillStyle = `${tone("card").trim()}dd`; // so that a solid that is zoomed in does not hide the bar's text
  pen.fillRect(SIZE[0] - PLOT.right, 0, PLOT.right, SIZE[1]);
  bar(pen, data.parts[state.part], SIZE[0] - 84, 20, SIZE[1] - 70);
  const [x, y] = [46, SIZE[1] - 60], unit = (solid.size() * SIZE[1]) / 2; // pixels a mm
  solid.axes().forEach(([u, v], i) => {
    line(pen, tone("ink"), 1.5, [x, y], [x + 26 * u, y - 26 * v]);
    write(pen, "xyz"[i], x + 36 * u, y - 36 * v);
  });
  const length = [0.5, 1, 2, 5, 10].find((mm) => mm * unit > 50) ?? 10;
  line(pen, tone("ink"), 2, [110, SIZE[1] - 30], [110 + length * unit, SIZE[1] - 30]);
  write(pen, `${length} mm`, 110 + (length * unit) / 2, SIZE[1] - 18);
}

const FORCE_TONES = ["c1", "c2", "c0"];
const spread = data.bundles.flatMap((b) => (b.force ?? []).flat()).reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [-1e-3, 1e-3]);
const forceAt = ({ bundle: { frames: { length } } }, i) => PLOT.left + (FORCE[0] - PLOT.left - PLOT.right) * (length > 1 ? i / (length - 1) : 0.5);
function drawForce(side, k) {
  const pen = sharp(side.force, FORCE), { force, frames, segments } = side.bundle, right = FORCE[0] - PLOT.right;
  const y = (value) => 18 + (FORCE[1] - 18 - 34) * (1 - (value - spread[0]) / (spread[1] - spread[0]));
  for (const value of ticks(...spread, Math.max(3, FORCE[1] / 60))) {
    line(pen, tone("line"), 1, [PLOT.left, y(value)], [right, y(value)]);
    write(pen, short(value), PLOT.left - 6, y(value), "right");
  }
  segments.forEach((segment, i) => {
    if (i && segment === segments[i - 1]) return;
    if (i) line(pen, tone("soft"), 1, [forceAt(side, i - 0.5), 12], [forceAt(side, i - 0.5), FORCE[1] - 34]);
    write(pen, segment, forceAt(side, i), 7, "left");
  });
  for (const axis of force ? [0, 1, 2] : []) {
    const at = force.map((values, i) => [forceAt(side, i), y(values[axis])]), radius = at.length > 1 ? 2 : 4;
    pen.fillStyle = tone(FORCE_TONES[axis]);
    line(pen, pen.fillStyle, 1.6, ...at);
    for (const [u, v] of at) pen.fill(new Path2D(`M${u - radius} ${v}a${radius} ${radius} 0 1 0 ${2 * radius} 0a${radius} ${radius} 0 1 0 ${-2 * radius} 0`));
    pen.fillText(`F${"xyz"[axis]} ${fixed(force[k][axis], 3)} N`, right + 8, 30 + 18 * axis);
  }
  if (side.bundle.error?.[k]) write(pen, side.bundle.error[k], right + 8, 84, "left");
  line(pen, tone("ink"), 1, [forceAt(side, k), 14], [forceAt(side, k), FORCE[1] - 34]);
  for (const i of new Set(ticks(0, frames.length - 1 || 1, 8).filter((i) => Number.isInteger(i) && i < frames.length))) write(pen, frames[i], forceAt(side, i), FORCE[1] - 24);
  write(pen, force ? "frame" : "frame (no forces)", (PLOT.left + right) / 2, FORCE[1] - 8);
  write(pen, "force on gel [N]", 12, FORCE[1] / 2 - 8, "center", -Math.PI / 2);
}

const place = (side) => Math.min(state.k, side.bundle.frames.length - 1);
function draw() {
  const solid = state.layer === "stress";
  slider.value = state.k;
  only.hidden = !solid;
  for (const side of sides) {
    const k = place(side), { frames, segments } = side.bundle;
    side.stage.children[0].style.visibility = solid && side.solid?.gl ? "visible" : "hidden";
    side.title.textContent = `frame ${frames[k]}, ${segments[k]}`;
    side.said.textContent = "";
    drawForce(side, k);
    if (solid) drawSolid(side, k);
    else drawMap(side, state.layer, k);
  }
}

function said(side, event) { // the value under the pointer
  const { shown, bundle } = side, x = (event.offsetX - shown?.left) / shown?.width, y = (event.offsetY - PLOT.top) / shown?.height;
  if (!(x >= 0 && x < 1 && y >= 0 && y < 1) || state.layer === "stress") return (side.said.textContent = "");
  const [x0, y0, x1, y1] = bundle.box, level = shown.levels?.[Math.floor(y * shown.canvas.height) * shown.canvas.width + Math.floor(x * shown.canvas.width)];
  const value = level === undefined ? "" : level ? `: ${short(shown.scale.low + ((level - 1) / 254) * (shown.scale.high - shown.scale.low))} (${shown.scale.label})` : ": none";
  side.said.textContent = `x ${fixed(x0 + x * (x1 - x0), 2)}, y ${fixed(y0 + y * (y1 - y0), 2)} ${bundle.unit}${value}`;
}

const bars = make("div", root, { className: "toolbar" });
const play = make("button", bars, { textContent: "play", type: "button" });
const slider = make("input", bars, { type: "range", min: 0, max: most - 1, value: 0, title: "frame; arrow keys too" });
slider.hidden = play.hidden = most < 2;
slider.oninput = () => { state.k = +slider.value; draw(); };
const now = make("p", bars, { className: "now", hidden: data.bundles.length > 1 });
const jumps = make("span", bars), chosen = make("span", bars, { className: "choices" }), only = make("span", bars);
let clock = 0;
play.onclick = () => {
  play.textContent = clock ? "play" : "stop";
  clock = clock ? clearInterval(clock) : setInterval(() => { state.k = (state.k + 1) % most; draw(); }, 200);
};
data.layers.forEach((name) => {
  const label = make("label", chosen), button = make("input", label, { type: "radio", name: "layer", value: name, checked: name === state.layer });
  label.append(name);
  button.onchange = () => { state.layer = name; draw(); };
});
const select = make("select", only);
data.parts.forEach((part) => make("option", select, { textContent: part.label }));
select.onchange = () => { state.part = select.selectedIndex; draw(); };
for (const [name, text] of [["cut", "cut through the indenter"], ["indenter", "indenter"]]) {
  const label = make("label", only), box = make("input", label, { type: "checkbox", checked: true });
  label.append(text);
  box.onchange = () => { state[name] = box.checked; draw(); };
}
make("span", only, { className: "soft", textContent: "drag to turn, wheel to zoom" });

const row = make("div", root, { className: "sides" });
const sides = data.bundles.map((bundle, number) => {
  const box = make("section", row, { className: "side" }), side = { bundle, number, box };
  const told = make("div", box, { className: "card told" }), map = make("div", box, { className: "card map" });
  make("h3", told, { textContent: bundle.name });
  make("p", told, { textContent: bundle.about });
  if (bundle.rejected) make("p", told, { textContent: bundle.rejected, className: "bad" });
  side.title = now.hidden ? make("p", told) : now;
  side.stage = make("div", map, { className: "stage" });
  const behind = make("canvas", side.stage);
  side.canvas = make("canvas", side.stage, { className: "solid" });
  side.said = make("p", map, { className: "said" });
  side.force = make("canvas", make("div", box, { className: "card forces" }), { className: "force" });
  side.solid = bundle.solid && new Solid(behind, bundle.solid);
  side.force.onclick = (event) => {
    const part = (event.offsetX - PLOT.left) / (FORCE[0] - PLOT.left - PLOT.right);
    state.k = Math.round(Math.min(1, Math.max(0, part)) * (bundle.frames.length - 1));
    draw();
  };
  side.canvas.onpointermove = (event) => {
    if (event.buttons && state.layer === "stress") {
      state.turn = [state.turn[0] - event.movementX / 150, Math.min(1.57, Math.max(-1.57, state.turn[1] + event.movementY / 150))];
      draw();
    } else said(side, event);
  };
  side.canvas.onpointerdown = (event) => side.canvas.setPointerCapture(event.pointerId);
  side.canvas.addEventListener("wheel", (event) => {
    if (state.layer !== "stress") return;
    event.preventDefault();
    state.zoom = Math.min(10, Math.max(0.3, state.zoom * Math.exp(-event.deltaY / 600)));
    draw();
  }, { passive: false });
  return side;
});
const marked = new Map(data.bundles.flatMap((b) => Object.entries(b.marks)).map(([what, frame]) => [`${what} (${frame})`, frame]));
for (const [text, frame] of marked) { // of both bundles
  make("button", jumps, { type: "button", textContent: text }).onclick = () => { state.k = nearest(frame); draw(); };
}
function nearest(frame) { // its place among those shown
  const frames = data.bundles.reduce((a, b) => (b.frames.length > a.frames.length ? b : a)).frames;
  return frames.reduce((best, n, i) => (Math.abs(n - frame) < Math.abs(frames[best] - frame) ? i : best), 0);
}
function fit() { // the sides fill the window, with the force beside the map where a single one is wide enough
  const { paddingLeft, paddingRight } = getComputedStyle(row), whole = root.clientWidth - parseFloat(paddingLeft) - parseFloat(paddingRight);
  const across = sides.length * LEAST + GAP < whole ? sides.length : 1, wide = sides.length === 1 && whole > 1000;
  const width = wide ? 0.66 * whole : (whole - GAP * (across - 1)) / across, above = bars.offsetHeight + (wide ? 160 : 330); // [px] of the window's height
  const aspect = Math.max(...data.bundles.map(({ box: [x0, y0, x1, y1] }) => (y1 - y0) / (x1 - x0)));
  const [beside, below] = [PLOT.left + PLOT.right, PLOT.top + PLOT.bottom], room = Math.max(260, innerHeight - above);
  const enough = Math.max((room - below) / aspect + beside, data.parts.length ? 1.4 * room : 0); // a solid is wide
  SIZE[0] = Math.floor(Math.max(LEAST, Math.min(width - AROUND, enough)));
  SIZE[1] = Math.floor(Math.min(room, (SIZE[0] - beside) * aspect + below));
  FORCE[0] = wide ? Math.floor(whole - SIZE[0] - GAP - 2 * AROUND) : SIZE[0];
  for (const { stage, force, solid, box, said } of sides) {
    box.classList.toggle("wide", wide);
    Object.assign(stage.style, { width: `${SIZE[0]}px`, height: `${SIZE[1]}px` });
    for (const canvas of stage.children) Object.assign(canvas.style, { width: `${SIZE[0]}px`, height: `${SIZE[1]}px` });
    FORCE[1] = wide ? SIZE[1] + said.offsetHeight + box.querySelector(".told").offsetHeight + 8 : 170;
    Object.assign(force.style, { width: `${FORCE[0]}px`, height: `${FORCE[1]}px` });
    solid?.resize();
  }
  draw();
}
function follow() { // page.html#layer=stress&frame=3
  const asked = new URLSearchParams(location.hash.slice(1));
  if (data.layers.includes(asked.get("layer"))) chosen.querySelector(`[value=${asked.get("layer")}]`).click();
  if (asked.has("frame")) state.k = nearest(+asked.get("frame") || 0);
  draw();
}
addEventListener("resize", fit);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
addEventListener("hashchange", follow);
fit();
follow();
})();
