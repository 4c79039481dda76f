// The page of a laboratory: it draws what the server sends, and sends what a person sets.
// All text enters by textContent, so that none of it is markup, wherever it comes from.
"use strict";

const element = (id) => document.getElementById(id);
const IN_SPACE = ["room", "photograph", "hidden", "occluders", "handles"]; // drawn in 3-D
const state = {}; // what the server sent last, by name: see page.py
let socket;

const send = (message) => {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
};

function connect() {
  socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/#.*/, ""));
  socket.onmessage = (event) => {
    const news = JSON.parse(event.data);
    Object.assign(state, news);
    for (const name in news) shows[name]?.(news[name]);
    if (IN_SPACE.some((name) => name in news)) redraw();
  };
  socket.onclose = () => {
    lines("trouble", ["The command that serves this page has ended."]);
    setTimeout(connect, 2000);
  };
}

// -- beside the scene -----------------------------------------------------------------------------

const showValue = {}; // by control: shows the server's value

const make = (kind, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(kind), properties);
  made.append(...children);
  return made;
};

const lines = (id, texts) => element(id).replaceChildren(...texts.map((text) => make("div", {}, text)));

const labelled = ({ label }, ...inputs) => make("label", {}, make("span", { title: label }, label), ...inputs);

// By kind of control: return its element, and the function that shows its value.
const kinds = {
  button: (control, set) => {
    const button = make("button", { onclick: () => set(true) });
    return [button, (label) => (button.textContent = label)];
  },

  choice: (control, set) => {
    const options = control.options.map((name) => new Option(name, name));
    const list = make("select", { onchange: () => set(list.value) }, ...options);
    return [labelled(control, list), (value) => (list.value = value)];
  },

  slider: (control, set) => {
    const { low, high, step } = control;
    const digits = Math.max(0, Math.round(-Math.log10(step)));
    const slider = make("input", { type: "range", max: Math.round((high - low) / step) });
    const field = make("input", { type: "number", step, ariaLabel: control.label });
    let moved = 0; // when a person moved the slider: for a while, it does not follow the server
    const show = (value) => {
      const wait = moved + 300 - Date.now();
      if (wait > 0) return setTimeout(() => show(state.values[control.id]), wait);
      slider.value = Math.round((value - low) / step);
      field.value = value.toFixed(digits);
    };
    slider.oninput = () => {
      const value = Math.min(low + slider.value * step, high);
      field.value = value.toFixed(digits);
      moved = Date.now();
      set(value);
    };
    field.onchange = () => {
      if (field.value) set(Math.min(Math.max(+field.value, low), high));
      else show(state.values[control.id]); // empty, or no number
    };
    return [labelled(control, slider, field), show];
  },
};

function showControls(controls) {
  const [box, groups] = [element("controls"), {}];
  box.replaceChildren();
  for (const control of controls) {
    const set = (value) => send({ control: control.id, value });
    const [shown, show] = kinds[control.kind](control, set);
    showValue[control.id] = show;
    const open = !Object.keys(groups).length; // the first group of sliders
    const summary = make("summary", {}, control.group ?? "");
    if (control.group) groups[control.group] ??= box.appendChild(make("details", { open }, summary));
    (groups[control.group] ?? box).append(shown);
  }
}

/** Keep as many children in a box as there are values, and show one value by each. */
function showEach(box, values, add, show) {
  while (box.children.length < values.length) box.append(add());
  while (box.children.length > values.length) box.lastChild.remove();
  values.forEach((value, i) => show(box.children[i], value));
}

/** A panel: its pictures, the scale of their false colours, and its caption. */
const addPanel = () => element("panel").content.firstElementChild.cloneNode(true);

function showPanel(figure, { caption, pictures, scale }) {
  const [box, text] = figure.children;
  showEach(box, pictures, () => make("img"), (image, { source, columns }) => {
    Object.assign(image, { src: source, alt: caption });
    image.style.flexGrow = columns;
  });
  text.lastChild.textContent = caption;
  text.firstChild.hidden = !scale;
  if (!scale) return;
  const [bar, low, high] = text.firstChild.children;
  bar.style.background = `linear-gradient(to right, ${scale.colours.join(", ")})`;
  [low.textContent, high.textContent] = [scale.low, scale.high];
}

const shows = {
  panels: (panels) => showEach(element("panels"), panels, addPanel, showPanel),
  status: (texts) => lines("status", texts),
  trouble: (texts) => lines("trouble", texts),
  notes: (texts) => lines("notes", gl ? texts : [...texts, NO_WEBGL]),
  controls: showControls,
  values: (values) => Object.entries(values).forEach(([name, value]) => showValue[name]?.(value)),
  room: (room) => {
    document.body.style.setProperty("--hatching", `url(${room.hatching})`);
    if (!camera.distance) Object.assign(camera, room.view);
    for (const name of ["floor", "wall"]) setSurface(name, room[name], { colour: name, darkest: 1 });
  },
  photograph: (image) => setImage("photograph", image),
  hidden: (images) => images.forEach((image, i) => setImage(`hidden ${i}`, image)),
  occluders: (occluders) => {
    const look = { colour: "occluder", darkest: 0.45 };
    occluders.forEach(({ vertices, faces }, i) => setMesh(`occluder ${i}`, vertices, faces, look));
  },
};

// -- vectors --------------------------------------------------------------------------------------

const plus = (a, b, t = 1) => a.map((x, i) => x + t * b[i]);
const minus = (a, b) => plus(a, b, -1);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const unit = (a) => a.map((x) => x / Math.hypot(...a));

/** Transform a point by a matrix; with w = 0 a direction. */
function apply(matrix, vector, w = 1) {
  const point = matrix.transformPoint(new DOMPoint(...vector, w));
  return [point.x, point.y, point.z].map((x) => (w ? x / point.w : x));
}

// -- camera ---------------------------------------------------------------------------------------

const camera = { target: [0, 0, 0], azimuth: 0, elevation: 0, distance: 0 }; // metres, degrees
const TANGENT = Math.tan((37.5 * Math.PI) / 180); // of half the field of view, along the shorter side

/** The matrix from the camera's axes, right, up and backwards, to the scene. */
const pose = () =>
  new DOMMatrix()
    .translate(...camera.target)
    .rotate(90 - camera.elevation, 0, 90 + camera.azimuth)
    .translate(0, 0, camera.distance);

/** The focal length in pixels of the canvas. */
const focalLength = () => Math.min(marks.clientWidth, marks.clientHeight) / 2 / TANGENT;

/** The matrix from the scene to WebGL's clip space. */
function projection() {
  const [wide, high] = [marks.clientWidth, marks.clientHeight].map((side) => (2 * focalLength()) / side);
  const [near, far] = [camera.distance / 100, camera.distance * 20];
  const [a, b] = [(far + near) / (near - far), (2 * far * near) / (near - far)];
  return new DOMMatrix([wide, 0, 0, 0, 0, high, 0, 0, 0, 0, a, -1, 0, 0, b, 0]).multiply(pose().inverse());
}

/** The matrix from the scene to pixels of the canvas, and a depth from -1 to 1. */
function toPixels() {
  const [x, y] = [marks.clientWidth / 2, marks.clientHeight / 2];
  return new DOMMatrix().translate(x, y).scale(x, -y).multiply(projection());
}

/** Where a point of the scene is on the screen, in pixels of the canvas. */
function onScreen(point) {
  const [x, y, depth] = apply(toPixels(), point);
  return depth > 1 ? [NaN, NaN] : [x, y]; // behind the eye: neither drawn nor gripped
}

/** The ray through a pixel of the canvas: its origin and its direction, of length 1. */
function rayThrough(pixel) {
  const eye = apply(pose(), [0, 0, 0]);
  return [eye, unit(minus(apply(toPixels().inverse(), [...pixel, 1]), eye))];
}

// -- the scene ------------------------------------------------------------------------------------

const marks = element("marks");
const gl = element("scene").getContext("webgl2", { antialias: true });
const NO_WEBGL = "This browser lacks WebGL 2, so the page cannot draw the scene. The sliders work.";
const meshes = {}; // by name: buffers, the count of indices, and a texture or a colour
const latest = {}; // image by name, which may not be decoded yet
let program;

const VERTEX = `#version 300 es
uniform mat4 view; uniform ivec2 lines; in vec3 point; out vec3 world; out vec2 uv;
void main() {
  world = point;
  uv = vec2(gl_VertexID % lines.x, gl_VertexID / lines.x) / vec2(lines - 1);
  gl_Position = view * vec4(point, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D image; uniform bool textured; uniform vec3 colour, eye; uniform float darkest;
in vec3 world; in vec2 uv; out vec4 pixel;
void main() {
  // A face is as bright as it turns towards the eye, flat and alike from both sides.
  vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
  float facing = abs(dot(normal, normalize(eye - world)));
  pixel = vec4(colour * mix(darkest, 1.0, facing), 1.0);
  if (textured) pixel = texture(image, uv);
  pixel = pixel.a < 0.5 ? vec4(0.0) : vec4(pixel.rgb, 1.0); // through holes, the hatching behind
}`;

function compile() {
  program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "point");
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);
}
if (gl) compile();
else element("scene").hidden = true;

function setMesh(name, vertices, faces, look) {
  if (!gl) return;
  meshes[name] ??= { array: gl.createVertexArray(), points: gl.createBuffer(), faces: gl.createBuffer() };
  const mesh = Object.assign(meshes[name], look, { count: faces.length });
  gl.bindVertexArray(mesh.array);
  gl.bindBuffer(gl.ARRAY_BUFFER, mesh.points);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(vertices), gl.DYNAMIC_DRAW);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.faces);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces), gl.DYNAMIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
}

/** Show a surface, whose grid of points begins at its upper left. */
function setSurface(name, grid, look) {
  const [rows, columns] = [grid.length, grid[0].length];
  const faces = [];
  for (let i = 1; i < rows; i++) for (let j = 1; j < columns; j++) {
    const [beneath, above] = [i * columns + j, (i - 1) * columns + j];
    faces.push(above - 1, beneath - 1, above, above, beneath - 1, beneath);
  }
  setMesh(name, grid.flat(2), faces, { ...look, lines: [columns, rows] });
}

function setImage(name, { grid, source }) {
  if (!gl) return;
  const picture = (latest[name] = new Image());
  picture.onload = () => {
    if (latest[name] !== picture) return; // a newer one was decoded before
    const texture = meshes[name]?.texture ?? gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    const [LINEAR, NEAREST, EDGE] = [gl.LINEAR, gl.NEAREST, gl.CLAMP_TO_EDGE];
    const settings = { MIN_FILTER: LINEAR, MAG_FILTER: NEAREST, WRAP_S: EDGE, WRAP_T: EDGE };
    for (const key in settings) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], settings[key]);
    setSurface(name, grid, { texture });
    redraw();
  };
  picture.src = source;
}

/** A colour of the style sheet, which follows the reader's system: its text. */
const colourOf = (name) => getComputedStyle(document.body).getPropertyValue(`--${name}`);
const channels = (colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16) / 255);

function drawScene() {
  const uniform = (name) => gl.getUniformLocation(program, name);
  gl.viewport(0, 0, gl.canvas.width, gl.canvas.height);
  gl.clearColor(...channels(colourOf("page")), 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.uniformMatrix4fv(uniform("view"), false, projection().toFloat32Array());
  gl.uniform3fv(uniform("eye"), apply(pose(), [0, 0, 0]));
  for (const { array, texture, colour, darkest, lines, count } of Object.values(meshes)) {
    gl.bindVertexArray(array);
    gl.bindTexture(gl.TEXTURE_2D, texture ?? null);
    gl.uniform1i(uniform("textured"), texture ? 1 : 0);
    gl.uniform2iv(uniform("lines"), lines ?? [2, 2]);
    gl.uniform3fv(uniform("colour"), channels(colourOf(colour ?? "page")));
    gl.uniform1f(uniform("darkest"), darkest ?? 1);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
  }
}

// -- handles --------------------------------------------------------------------------------------

const COLOURS = ["#d62728", "#2ca02c", "#1f77b4"]; // of arrows along x, y and z
const REACH = 9; // pixels within which the pointer grips an arrow or a centre
let grip; // what is dragged: a handle's name, its position, and where a ray takes it

/** The arrows of a handle: the number of their axis, and both ends on the screen. */
function arrows(handle) {
  const from = handle.name === grip?.name ? grip.position : handle.position;
  return [0, 1, 2].filter((axis) => handle.axes[axis]).map((axis) => {
    const to = from.with(axis, from[axis] + state.room.arrow);
    return { axis, start: onScreen(from), end: onScreen(to) };
  });
}

/** Draw a handle; with an edge, in pixels, the outline that keeps it legible before everything. */
function drawHandle(pen, handle, edge) {
  const ink = (colour, width) => {
    pen.strokeStyle = pen.fillStyle = edge ? colourOf("page") : colour;
    pen.lineWidth = width + edge;
  };
  const drawn = arrows(handle);
  for (const { axis, start, end } of drawn) {
    const along = unit(minus(end, start));
    const tip = (t, s) => plus(plus(end, along, t), [-along[1], along[0]], s);
    const arrow = new Path2D();
    for (const point of [start, end, tip(0, 4), tip(8, 0), tip(0, -4), end]) arrow.lineTo(...point);
    ink(COLOURS[axis], 2);
    pen.stroke(arrow);
    pen.fill(arrow);
  }
  const [x, y] = drawn[0].start;
  ink(colourOf("text"), 1);
  pen.beginPath();
  pen.arc(x, y, 4, 0, 2 * Math.PI);
  pen.stroke();
  pen.fill();
  const label = [handle.name, x, Math.min(...drawn.map(({ end }) => end[1])) - 18];
  if (edge) pen.strokeText(...label);
  pen.fillText(...label);
}

function drawHandles() {
  const pen = marks.getContext("2d");
  const scale = marks.width / marks.clientWidth;
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, marks.clientWidth, marks.clientHeight);
  Object.assign(pen, { font: "13px sans-serif", textAlign: "center", lineJoin: "round" });
  for (const edge of [3, 0]) state.handles?.forEach((handle) => drawHandle(pen, handle, edge));
}

/** The grip on the handle under a pixel: on an arrow or on the centre; none where there is no handle. */
function gripAt(pixel) {
  const isNear = (point) => Math.hypot(...minus(pixel, point)) < REACH;
  for (const { name, axes, position } of state.handles ?? []) {
    const drawn = arrows({ name, axes, position });
    const onCenter = drawn.length > 1 && isNear(drawn[0].start);
    const arrow = drawn.findLast(({ start, end }) => {
      const line = minus(end, start);
      const t = Math.min(Math.max(dot(minus(pixel, start), line) / dot(line, line), 0), 1.1);
      return isNear(plus(start, line, t));
    });
    if (!onCenter && !arrow) continue;
    // It follows the ray in a plane: that of the screen, or the one along the arrow that faces it most.
    const free = onCenter ? axes : axes.map((_, i) => i === arrow.axis);
    const normal = apply(pose(), [0, 0, 1], 0).map((x, i) => (onCenter || !free[i] ? x : 0));
    const way = ([eye, direction]) => {
      const hit = plus(eye, direction, dot(minus(position, eye), normal) / dot(direction, normal));
      return minus(hit, position).map((x, i) => (free[i] ? x : 0));
    };
    const start = way(rayThrough(pixel));
    return { name, position, follow: (ray) => plus(position, minus(way(ray), start)) };
  }
}

const drag = (ends) => send({ handle: grip.name, position: grip.position, ends });

// -- pointer and keys -----------------------------------------------------------------------------

let pressed; // the last place of a pointer that turns or shifts the view
const placeOf = (event) => [event.offsetX, event.offsetY];

/** Turn the view, as a pointer does that moves by some pixels, and zoom by some steps. */
function look(x, y, steps) {
  camera.azimuth -= 0.3 * x;
  camera.elevation = Math.min(Math.max(camera.elevation + 0.3 * y, -86), 86);
  camera.distance *= Math.exp(0.1 * steps);
  redraw();
}

marks.onpointerdown = (event) => {
  if (grip) return; // of a second finger: the server waits until the handle is let go
  marks.setPointerCapture(event.pointerId);
  grip = event.button ? undefined : gripAt(placeOf(event));
  if (!grip) pressed = placeOf(event);
};
marks.onpointermove = (event) => {
  if (grip) {
    grip.position = grip.follow(rayThrough(placeOf(event)));
    drag(false);
    redraw();
  } else if (pressed) {
    const [x, y] = minus(placeOf(event), pressed);
    pressed = placeOf(event);
    if (event.buttons & 1 && !event.shiftKey) return look(x, y, 0);
    const metres = camera.distance / focalLength();
    camera.target = minus(camera.target, apply(pose(), [x * metres, -y * metres, 0], 0));
    redraw();
  }
};
marks.onpointerup = marks.onpointercancel = () => {
  if (grip) drag(true);
  grip = pressed = undefined;
};
marks.onwheel = (event) => {
  event.preventDefault();
  look(0, 0, Math.sign(event.deltaY));
};
marks.oncontextmenu = (event) => event.preventDefault();

const KEYS = {
  ArrowLeft: [20, 0, 0], ArrowRight: [-20, 0, 0], ArrowUp: [0, 20, 0], ArrowDown: [0, -20, 0],
  "+": [0, 0, -1], "-": [0, 0, 1],
};
document.onkeydown = (event) => {
  const isCommand = event.ctrlKey || event.metaKey;
  const undoes = isCommand && event.key === "z" && event.target.type !== "number"; // not what is typed
  const views = !isCommand && !event.altKey && event.target === marks && event.key in KEYS;
  if (undoes || views) event.preventDefault();
  if (undoes) send({ control: "undo", value: true });
  if (views) look(...KEYS[event.key]);
};

// -- frames ---------------------------------------------------------------------------------------

let waiting = false;

// A lost context, as of a GPU that starts anew, takes all textures with it.
element("scene").addEventListener("webglcontextlost", (event) => event.preventDefault());
element("scene").addEventListener("webglcontextrestored", () => location.reload());

/** Draw once before the browser's next frame. */
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    for (const canvas of [marks, element("scene")]) {
      const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((x) => Math.round(x * devicePixelRatio));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    }
    if (gl && camera.distance) drawScene();
    if (camera.distance) drawHandles();
  });
}
window.onresize = matchMedia("(prefers-color-scheme: dark)").onchange = redraw;
connect();
