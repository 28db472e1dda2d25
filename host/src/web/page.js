"use strict";
// Everything is in this file: nothing is asked of a server. See Rigel, host/src/web.rs and host/src/shader/.
const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const canvas = byId("picture");
const tell = (text) => { byId("told").textContent = text; };
// As `Packed::ROW`.
const ROW = 4096;
// A link may name a camera and a map: #{"map":0,"fx":..,"fy":..,"cx":..,"cy":..,"width":..,"height":..,"right":[..],"down":[..],"forward":[..],"centre":[..],"gamma":..}
let fixed = null;
try { if (location.hash.length > 1) fixed = JSON.parse(decodeURIComponent(location.hash.slice(1))); } catch { fixed = null; }
if (fixed) document.body.className = "bare";

const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
const view = { map: (fixed && fixed.map) || 0, azimuth: -Math.PI / 2, zenith: 0.5, distance: 4, exposure: 0, colours: false };
const start = { ...view };
let shown = null;

async function unpacked(text) {
  const characters = atob(text), bytes = new Uint8Array(characters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = characters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The bits of a half float.
const single = new Float32Array(1), bits = new Uint32Array(single.buffer);
function half(value) {
  single[0] = value;
  const b = bits[0], sign = (b >>> 16) & 0x8000, exponent = ((b >>> 23) & 255) - 112, digits = b & 0x7fffff;
  if (exponent >= 31) return sign | 0x7bff;
  if (exponent <= 0) {
    if (exponent < -10) return sign;
    const shift = 14 - exponent, whole = digits | 0x800000;
    return sign | ((whole + (1 << (shift - 1))) >> shift);
  }
  return sign + (exponent << 10) + ((digits + 0x1000) >> 13);
}

function unfold(x, y) {
  const z = 1 - Math.abs(x) - Math.abs(y);
  if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
  const length = Math.hypot(x, y, z);
  return [x / length, y / length, z / length];
}

// The planes of whole numbers become the vectors that the shader loads; see `Quantised::compressed`.
function vectors(map, bytes) {
  const count = map.columns * map.rows, { parts, has_choice, has_palette } = map.models;
  let at = 0;
  const take = (n) => bytes.subarray(at, (at += n));
  const choice = has_choice ? take(count) : null, palette = has_palette ? take(count) : null;
  const sizes = parts.map((part) => Math.ceil(part.parameters / (part.is_half ? 8 : 4)));
  const first = [];
  let total = 0;
  parts.forEach((part, i) => { first.push(total); total += sizes[i] * part.slots; });
  const rows = Math.max(1, Math.ceil(total / ROW));
  const words = new Uint32Array(rows * ROW * 4), halves = new Uint16Array(words.buffer), floats = new Float32Array(words.buffer);
  const plane = (slots, add) => {
    const stepped = take(1)[0], low = take(slots), high = take(slots), values = new Int16Array(slots);
    for (let i = 0, before = 0; i < slots; i++) {
      const folded = low[i] | (high[i] << 8);
      let v = (folded >>> 1) ^ -(folded & 1);
      if (stepped) v = before = ((before + v) << 16) >> 16;
      values[i] = add ? v + add[i] : v;
    }
    return values;
  };
  parts.forEach((part, number) => {
    const slots = part.slots, size = sizes[number];
    const where = new Map(part.order.map((index, i) => [index, i]));
    for (const group of part.groups) {
      const step = Math.fround(group.step);
      if (group.kind === "direction") {
        const x = plane(slots), y = plane(slots);
        for (let s = 0; s < slots; s++) floats.set(unfold(x[s] * step, y[s] * step), (first[number] + s * size) * 4 + group.first);
        continue;
      }
      const isColour = group.count % 3 === 0;
      for (let i = 0; i < group.count; i += isColour ? 3 : 1) {
        let planes;
        if (isColour) {
          // Red and blue come as differences from green, which stands between them.
          const start = at;
          at += 1 + 2 * slots;
          const green = plane(slots);
          const after = at;
          at = start;
          const red = plane(slots, green);
          at = after;
          planes = [red, green, plane(slots, green)];
        } else planes = [plane(slots)];
        planes.forEach((values, c) => {
          const parameter = group.first + i + c;
          const place = part.order.length ? 3 * where.get(Math.floor(parameter / 3)) + (parameter % 3) : parameter;
          if (part.is_half) {
            const table = tableOf(step / map.scale);
            for (let s = 0, to = first[number] * 8 + place; s < slots; s++, to += size * 8) halves[to] = table[values[s] & 0xffff];
          } else {
            const back = { linear: (v) => v * step, root: (v) => v * step * Math.abs(v * step), logarithm: (v) => Math.exp(v * step) }[group.kind];
            for (let s = 0, to = first[number] * 4 + place; s < slots; s++, to += size * 4) floats[to] = back(values[s]);
          }
        });
      }
    }
  });
  const places = new Uint32Array(count), next = parts.map(() => 0), entries = new Map();
  for (let i = 0; i < count; i++) {
    const number = choice ? choice[i] : 0, entry = palette ? palette[i] : 0;
    if (entry && entries.has(entry)) { places[i] = entries.get(entry); continue; }
    places[i] = ((number << 27) | (first[number] + next[number]++ * sizes[number])) >>> 0;
    if (entry) entries.set(entry, places[i]);
  }
  return { places, words, rows };
}

const tables = new Map();
function tableOf(step) {
  if (!tables.has(step)) tables.set(step, Uint16Array.from({ length: 65536 }, (_, i) => half(((i << 16) >> 16) * step)));
  return tables.get(step);
}

function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "the shader does not link");
  gl.useProgram(made);
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORM_BLOCKS); i++) gl.uniformBlockBinding(made, i, 0);
  for (const unit of [1, 2, 3]) gl.uniform1i(gl.getUniformLocation(made, `_group_0_binding_${unit}_fs`), unit);
  return made;
}

function texture(unit, internal, width, height, format, type, content) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, content);
  for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]])
    gl.texParameteri(gl.TEXTURE_2D, name, value);
  return made;
}

async function load(number) {
  const map = data.maps[number];
  const largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  const { places, words, rows } = vectors(map, await unpacked(map.data));
  if (Math.max(map.columns, map.rows, rows, ROW) > largest) throw new Error(`this map needs textures of ${Math.max(map.columns, map.rows, rows, ROW)} cells, and this browser takes ${largest}`);
  if (shown) {
    for (const old of [shown.places, shown.words, shown.shaded]) if (old) gl.deleteTexture(old);
    for (const old of Object.values(shown.programs)) gl.deleteProgram(old);
  }
  const made = { map, number, programs: {} };
  made.places = texture(1, gl.R32UI, map.columns, map.rows, gl.RED_INTEGER, gl.UNSIGNED_INT, places);
  made.words = texture(2, gl.RGBA32UI, ROW, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  const canShade = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
  if (canShade) {
    made.shaded = texture(3, gl.RGBA16F, map.columns, map.rows, gl.RGBA, gl.HALF_FLOAT, null);
    // With room for all averages.
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    made.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.shaded, 0);
    made.canShade = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }
  shown = made;
  byId("facts").replaceChildren(...map.facts.concat(made.canShade ? [] : ["this browser cannot draw into textures of half floats: every pixel evaluates the model, which is slower"]).map((fact) => {
    const item = document.createElement("li");
    item.textContent = fact;
    return item;
  }));
  byId("map").value = number;
  tell(`${map.name}, ${map.columns} × ${map.rows} texels`);
}

// A shader of the shown map, translated by the browser when it is needed first.
function shader(name) {
  const { programs, map } = shown;
  return (programs[name] = programs[name] || program(map.shaders.vertex, map.shaders[name]));
}

// As the window decides (host/view/src/scene.rs): by texel where that looks the same, and is not more work or averages are needed.
function isByTexel(seen) {
  const { map } = shown, size = Math.max(map.width_m / map.columns, map.height_m / map.rows);
  if (!shown.canShade || size > map.smooth * Math.max(seen.centre[2], 1e-9)) return false;
  return averages(seen) > 0 || map.columns * map.rows <= 4 * canvas.width * canvas.height;
}

// How many averages are needed where a pixel covers many texels.
function averages(seen) {
  const { map } = shown, across = (map.width_m / 2) * Math.abs(seen.forward[0]) + (map.height_m / 2) * Math.abs(seen.forward[1]);
  const farthest = across - seen.centre[0] * seen.forward[0] - seen.centre[1] * seen.forward[1] - seen.centre[2] * seen.forward[2];
  const covered = farthest / Math.min(seen.fx, seen.fy) / Math.min(map.width_m / map.columns, map.height_m / map.rows);
  return Math.min(Math.max(Math.ceil(Math.log2(Math.max(covered, 1e-9)) - 1), 0), Math.floor(Math.log2(Math.max(map.columns, map.rows))));
}

// The camera's axes (x right, y down, z forward) and its lens.
function camera() {
  if (fixed && fixed.fx) return fixed;
  const { map } = shown, size = Math.hypot(map.width_m, map.height_m), distance = view.distance * Math.max(map.width_m, map.height_m);
  const [s, c, sa, ca] = [Math.sin(view.zenith), Math.cos(view.zenith), Math.sin(view.azimuth), Math.cos(view.azimuth)];
  const pixels = Math.min(canvas.width, canvas.height), f = (0.95 * pixels * 4 * Math.max(map.width_m, map.height_m)) / size;
  return {
    fx: f, fy: f, cx: (canvas.width - 1) / 2, cy: (canvas.height - 1) / 2,
    centre: [distance * s * ca, distance * s * sa, distance * c],
    right: [-sa, ca, 0], down: [c * ca, c * sa, -s], forward: [-s * ca, -s * sa, -c],
  };
}

function draw() {
  if (!shown) return;
  const { map } = shown, ratio = fixed ? 1 : Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = fixed && fixed.width ? [fixed.width, fixed.height] : [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  if (fixed && fixed.width) [canvas.style.width, canvas.style.height] = [`${width}px`, `${height}px`];
  const seen = camera(), gamma = (seen.gamma || map.gamma) * 2 ** view.exposure;
  const byTexel = isByTexel(seen), levels = byTexel ? averages(seen) : 0;
  const numbers = new Float32Array(40);
  numbers.set(seen.right, 0);
  numbers.set(seen.down, 4);
  numbers.set(seen.forward, 8);
  numbers.set(seen.centre, 12);
  numbers.set([seen.fx, seen.fy, seen.cx, seen.cy], 16);
  numbers.set([map.width_m, map.height_m, map.columns, map.rows], 24);
  numbers.set([gamma, map.scale, 0, view.colours ? 1 : 0], 28);
  numbers.set([...(fixed ? [0, 0, 0] : [0.0863, 0.0941, 0.1059]), levels], 32);
  numbers.set([width, height], 36);
  gl.bufferData(gl.UNIFORM_BUFFER, numbers, gl.DYNAMIC_DRAW);
  const unit = (place, made) => { gl.activeTexture(gl.TEXTURE0 + place); gl.bindTexture(gl.TEXTURE_2D, made); };
  unit(1, shown.places);
  unit(2, shown.words);
  if (byTexel) {
    unit(3, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, shown.frame);
    gl.viewport(0, 0, map.columns, map.rows);
    gl.useProgram(shader("shade_texel"));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    unit(3, shown.shaded);
    if (levels > 0) gl.generateMipmap(gl.TEXTURE_2D);
  }
  gl.viewport(0, 0, width, height);
  gl.useProgram(shader(byTexel ? "by_texel" : "by_pixel"));
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  document.documentElement.dataset.drawn = String(shown.number);
}

let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    try { draw(); } catch (error) { tell(`This map cannot be shown: ${error.message}`); }
  });
}

function turn(azimuth, zenith) {
  view.azimuth += azimuth;
  view.zenith = Math.min(Math.max(view.zenith + zenith, 0), 1.53);
  redraw();
}

function zoom(factor) {
  view.distance = Math.min(Math.max(view.distance * factor, 0.3), 40);
  redraw();
}

function expose(steps) {
  view.exposure = Math.min(Math.max(view.exposure + steps, -5), 5);
  byId("exposure").value = view.exposure;
  redraw();
}

async function show(number) {
  tell("Reading…");
  try {
    await load((number + data.maps.length) % data.maps.length);
    draw();
  } catch (error) {
    tell(`This map cannot be shown: ${error.message}`);
    document.documentElement.dataset.drawn = "failed";
  }
}

function listen() {
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); });
  const release = (e) => pointers.delete(e.pointerId);
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointermove", (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    const spread = () => { const [a, b] = [...pointers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
    const was = pointers.size === 2 ? spread() : 0;
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
    if (pointers.size === 2) zoom(was / Math.max(spread(), 1));
    else turn((before[0] - e.clientX) * 0.008, (before[1] - e.clientY) * 0.008);
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(e.deltaY * 0.001)); }, { passive: false });
  const again = () => { Object.assign(view, start, { map: view.map }); byId("exposure").value = 0; byId("colours").checked = false; redraw(); };
  const colours = (on) => { view.colours = on; byId("colours").checked = on; redraw(); };
  const keys = {
    ArrowLeft: () => turn(-0.05, 0), ArrowRight: () => turn(0.05, 0), ArrowUp: () => turn(0, -0.05), ArrowDown: () => turn(0, 0.05),
    "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.11), "[": () => expose(-0.25), "]": () => expose(0.25),
    m: () => show(shown.number + 1), f: () => colours(!view.colours), 0: again, h: () => { byId("controls").hidden = !byId("controls").hidden; },
  };
  document.addEventListener("keydown", (e) => {
    // A slider has arrow keys of its own, a list letters too.
    const own = (e.target.matches("input[type=range], select") && e.key.startsWith("Arrow")) || (e.target.matches("select") && e.key.length === 1);
    if (own || e.ctrlKey || e.metaKey || e.altKey || !keys[e.key] || !shown) return;
    e.preventDefault();
    keys[e.key]();
  });
  byId("exposure").addEventListener("input", (e) => { view.exposure = Number(e.target.value); redraw(); });
  byId("colours").addEventListener("change", (e) => colours(e.target.checked));
  byId("map").addEventListener("change", (e) => show(Number(e.target.value)));
  byId("again").addEventListener("click", again);
  byId("controls").addEventListener("submit", (e) => e.preventDefault());
  window.addEventListener("resize", redraw);
  canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); shown = null; tell("The graphics device was lost; trying again…"); });
  canvas.addEventListener("webglcontextrestored", () => { prepare(); show(view.map); });
}

function prepare() {
  gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, gl.createBuffer());
  gl.bindVertexArray(gl.createVertexArray());
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
}

byId("map").replaceChildren(...data.maps.map((map, i) => new Option(map.name, i)));
byId("choose").hidden = data.maps.length < 2;
if (!gl) tell("This browser has no WebGL 2, which draws the surface.");
else if (typeof DecompressionStream === "undefined") tell("This browser is too old: it cannot read compressed data (DecompressionStream).");
else {
  prepare();
  listen();
  show(view.map);
}
