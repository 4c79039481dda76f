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
  socket = new WebSocket(location.href.replace(/^http/, "ws"));
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

const inputs = {}; // by control
let held; // the slider that is being moved: it does not follow the server

function lines(id, texts) {
  const rows = texts.map((text) => Object.assign(document.createElement("div"), { textContent: text }));
  element(id).replaceChildren(...rows);
}

const make = (kind, properties = {}) => Object.assign(document.createElement(kind), properties);

function addControl(control, places) {
  const set = (value) => send({ control: control.id, value });
  let made;
  if (control.kind === "button") {
    made = make("button", { onclick: () => set(true) });
    inputs[control.id] = (label) => {
      made.textContent = label;
      made.hidden = !label;
    };
  } else {
    made = make("label");
    made.append(make("span", { textContent: control.label, title: control.label }));
    if (control.kind === "choice") {
      const input = make("select", { onchange: () => set(input.value) });
      input.append(...control.options.map((name) => new Option(name, name)));
      inputs[control.id] = (value) => (input.value = value);
      made.append(input);
    } else {
      const digits = Math.max(0, Math.round(-Math.log10(control.step)));
      const count = Math.round((control.high - control.low) / control.step);
      const valueAt = (k) => Math.min(control.low + k * control.step, control.high);
      const input = make("input", { type: "range", min: 0, max: count, step: 1 });
      const typed = make("input", { type: "number", step: control.step });
      input.oninput = () => {
        typed.value = valueAt(+input.value).toFixed(digits);
        set(valueAt(+input.value));
      };
      typed.onchange = () => {
        if (typed.value) set(Math.min(Math.max(+typed.value, control.low), control.high));
        else typed.value = state.values[control.id].toFixed(digits); // empty, or no number
      };
      input.onpointerdown = () => (held = input);
      input.onpointerup = input.onpointercancel = () => (held = undefined);
      input.onkeydown = () => (held = input);
      input.onkeyup = input.onblur = () => setTimeout(() => (held = undefined), 300);
      inputs[control.id] = (value) => {
        if (held === input) return;
        input.value = Math.round((value - control.low) / control.step);
        typed.value = value.toFixed(digits);
      };
      made.append(input, typed);
    }
  }
  if (control.group && !places[control.group]) {
    const open = !Object.keys(places).length; // the first group of sliders
    places[control.group] = make("details", { open });
    places[control.group].append(make("summary", { textContent: control.group }));
    element("controls").append(places[control.group]);
  }
  (places[control.group] ?? element("controls")).append(made);
}

/** A panel: a picture, the scale of its false colours, and its caption. */
function figure() {
  const made = make("figure");
  const [image, scale, caption] = [make("img"), make("div", { className: "scale" }), make("figcaption")];
  const ends = [make("span"), make("span")];
  const bar = make("i");
  scale.append(ends[0], bar, ends[1]);
  made.append(image, scale, caption);
  made.show = (panel) => {
    image.hidden = !panel.source;
    if (panel.source) image.src = panel.source;
    caption.textContent = image.alt = panel.caption;
    scale.style.display = panel.scale ? "" : "none";
    if (!panel.scale) return;
    [ends[0].textContent, ends[1].textContent] = [panel.scale.low, panel.scale.high];
    bar.style.background = `linear-gradient(to right, ${panel.scale.colours.join(", ")})`;
  };
  return made;
}

const shows = {
  panels: (panels) => {
    const box = element("panels");
    while (box.children.length < panels.length) box.append(figure());
    while (box.children.length > panels.length) box.lastChild.remove();
    panels.forEach((panel, i) => box.children[i].show(panel));
  },
  status: (texts) => lines("status", texts),
  trouble: (texts) => lines("trouble", texts),
  notes: (texts) => lines("notes", gl ? texts : [...texts, NO_WEBGL]),
  controls: (controls) => {
    const places = {};
    element("controls").replaceChildren();
    controls.forEach((control) => addControl(control, places));
  },
  values: (values) => Object.entries(values).forEach(([name, value]) => inputs[name]?.(value)),
  room: (room) => {
    if (!camera.distance) lookFrom(room.view);
    setImage("floor", room.floor);
    setImage("wall", room.wall);
    document.body.style.setProperty("--hatching", `url(${room.hatching})`);
    setHatching(room.hatching);
  },
  photograph: (image) => setImage("photograph", image),
  hidden: (images) => images.forEach((image, i) => setImage(`hidden ${i}`, image)),
  occluders: setMeshes,
};

// -- vectors --------------------------------------------------------------------------------------

const plus = (a, b, t = 1) => a.map((x, i) => x + t * b[i]);
const minus = (a, b) => plus(a, b, -1);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
const unit = (a) => a.map((x) => x / Math.hypot(...a));

// -- camera ---------------------------------------------------------------------------------------

const camera = { target: [0, 0, 0], azimuth: 0, elevation: 0, distance: 0 };
const TANGENT = Math.tan((37.5 * Math.PI) / 180); // of half the field of view, along the shorter side

function lookFrom(view) {
  const [x, y, z] = minus(view.eye, view.target);
  camera.target = view.target;
  camera.distance = Math.hypot(x, y, z);
  camera.azimuth = Math.atan2(y, x);
  camera.elevation = Math.asin(z / camera.distance);
}

/** The camera's place and its axes: right, up and backwards, orthonormal. */
function pose() {
  const { azimuth, elevation } = camera;
  const flat = Math.cos(elevation);
  const back = [flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(elevation)];
  const right = [-Math.sin(azimuth), Math.cos(azimuth), 0];
  return { eye: plus(camera.target, back, camera.distance), right, up: cross(back, right), back };
}

/** The focal length in pixels of the canvas. */
const focalLength = () => Math.min(marks.clientWidth, marks.clientHeight) / 2 / TANGENT;

/** The matrix from the scene to the screen, column after column. */
function projection() {
  const { eye, right, up, back } = pose();
  const [wide, high] = [marks.clientWidth, marks.clientHeight].map((side) => (2 * focalLength()) / side);
  const [near, far] = [camera.distance / 100, camera.distance * 20];
  const scales = [wide, high, (far + near) / (near - far)];
  const rows = [right, up, back].map((axis, i) => [...axis, -dot(axis, eye)].map((x) => scales[i] * x));
  rows[2][3] += (2 * far * near) / (near - far);
  rows.push([...back.map((x) => -x), dot(back, eye)]);
  return [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
}

/** Where a point of the scene is on the screen, in pixels of the canvas. */
function onScreen(point) {
  const { eye, right, up, back } = pose();
  const [x, y, z] = [right, up, back].map((axis) => dot(axis, minus(point, eye)));
  if (z >= 0) return [NaN, NaN]; // behind the eye: neither drawn nor gripped
  const focal = focalLength();
  return [marks.clientWidth / 2 - (focal * x) / z, marks.clientHeight / 2 + (focal * y) / z];
}

/** The ray through a pixel of the canvas: its origin and its direction, of length 1. */
function rayThrough([x, y]) {
  const { eye, right, up, back } = pose();
  const focal = focalLength();
  const sideways = plus(right.map((r) => (r * (x - marks.clientWidth / 2)) / focal), back, -1);
  return [eye, unit(plus(sideways, up, (marks.clientHeight / 2 - y) / focal))];
}

// -- the scene ------------------------------------------------------------------------------------

const marks = element("marks");
const gl = element("scene").getContext("webgl2", { antialias: true });
const NO_WEBGL = "This browser draws no scene: it lacks WebGL 2. The sliders work.";
const things = {}; // by name: vertices, faces and their count, and a texture for an image
const latest = {}; // image by name, which may not be decoded yet
let program;

const VERTEX = `#version 300 es
uniform mat4 view; in vec3 point; in vec2 place; out vec3 world; out vec2 uv;
void main() { world = point; uv = place; gl_Position = view * vec4(point, 1.0); }`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D image, hatching; uniform bool textured; uniform vec3 eye;
in vec3 world; in vec2 uv; out vec4 colour;
void main() {
  if (textured) {
    colour = texture(image, uv);
    if (colour.a < 0.5) { // the tile's first row is above, as on the page
      colour = texture(hatching, vec2(gl_FragCoord.x, -gl_FragCoord.y) / vec2(textureSize(hatching, 0)));
    }
    return;
  }
  // A face is as bright as it turns towards the eye, flat and alike from both sides.
  vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
  float facing = abs(dot(normal, normalize(eye - world)));
  colour = vec4(vec3(0.59, 0.44, 0.31) * (0.45 + 0.55 * facing), 1.0);
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
  gl.bindAttribLocation(program, 1, "place");
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(1, 1, 1, 1);
}
if (gl) compile();

function buffer(name, target, values) {
  const thing = (things[name] ??= {});
  thing[target] ??= gl.createBuffer();
  gl.bindBuffer(target, thing[target]);
  gl.bufferData(target, values, gl.DYNAMIC_DRAW);
  return thing;
}

function setMesh(name, vertices, faces) {
  buffer(name, gl.ARRAY_BUFFER, new Float32Array(vertices));
  buffer(name, gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces)).count = faces.length;
}

function fill(texture, picture, wraps) {
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  const settings = { MIN_FILTER: gl.LINEAR, MAG_FILTER: gl.NEAREST, ...wraps };
  for (const key in settings) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], settings[key]);
}

/** Fill what is transparent in images with a tile. */
function setHatching(source) {
  if (!gl) return;
  const tile = new Image();
  tile.onload = () => {
    gl.activeTexture(gl.TEXTURE1);
    fill(gl.createTexture(), tile, {});
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(gl.getUniformLocation(program, "hatching"), 1);
    redraw();
  };
  tile.src = source;
}

/** Show an image on a surface, whose grid of points begins at the image's upper left. */
function setImage(name, { grid, source }) {
  if (!gl) return;
  const picture = (latest[name] = new Image());
  picture.onload = () => {
    if (latest[name] !== picture) return; // a newer one was decoded before
    const [rows, columns] = [grid.length - 1, grid[0].length - 1];
    const vertices = grid.flatMap((row, i) => row.flatMap((point, j) => [...point, j / columns, i / rows]));
    const faces = [];
    for (let i = 0; i < rows; i++) for (let j = 0; j < columns; j++) {
      const [above, beneath] = [i, i + 1].map((row) => row * (columns + 1) + j);
      faces.push(above, beneath, above + 1, above + 1, beneath, beneath + 1);
    }
    setMesh(name, vertices, faces);
    things[name].texture ??= gl.createTexture();
    fill(things[name].texture, picture, { WRAP_S: gl.CLAMP_TO_EDGE, WRAP_T: gl.CLAMP_TO_EDGE });
    redraw();
  };
  picture.src = source;
}

function setMeshes(occluders) {
  if (gl) occluders.forEach(({ vertices, faces }, i) => setMesh(`occluder ${i}`, vertices, faces));
}

function drawScene() {
  const size = [gl.canvas.width, gl.canvas.height];
  gl.viewport(0, 0, ...size);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, projection());
  gl.uniform3fv(gl.getUniformLocation(program, "eye"), pose().eye);
  for (const thing of Object.values(things)) {
    const floats = thing.texture ? 5 : 3; // a point, and its place in the image
    gl.bindBuffer(gl.ARRAY_BUFFER, thing[gl.ARRAY_BUFFER]);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, thing[gl.ELEMENT_ARRAY_BUFFER]);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 4 * floats, 0);
    if (thing.texture) {
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 4 * floats, 12);
      gl.bindTexture(gl.TEXTURE_2D, thing.texture);
    } else gl.disableVertexAttribArray(1);
    gl.uniform1i(gl.getUniformLocation(program, "textured"), thing.texture ? 1 : 0);
    gl.drawElements(gl.TRIANGLES, thing.count, gl.UNSIGNED_INT, 0);
  }
}

// -- handles --------------------------------------------------------------------------------------

const COLOURS = ["#d62728", "#2ca02c", "#1f77b4"]; // of arrows along x, y and z
const REACH = 9; // pixels within which the pointer grips an arrow or a centre
let grip; // what is dragged: a handle's name, its position, and where a ray takes it

/** The arrows of a handle: axis, its number, and both ends on the screen. */
function arrows(handle) {
  const from = handle.name === grip?.name ? grip.position : handle.position;
  return [0, 1, 2].filter((i) => handle.axes[i]).map((i) => {
    const axis = [0, 0, 0].with(i, 1);
    return { i, axis, start: onScreen(from), end: onScreen(plus(from, axis, state.room.arrow)) };
  });
}

function drawHandles() {
  const pen = marks.getContext("2d");
  const scale = marks.width / marks.clientWidth;
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, marks.clientWidth, marks.clientHeight);
  pen.font = "13px sans-serif";
  pen.textAlign = "center";
  for (const handle of state.handles ?? []) {
    const drawn = arrows(handle);
    for (const { i, start, end } of drawn) {
      const along = unit(minus(end, start));
      const tip = (t, s) => plus(plus(end, along, t), [-along[1], along[0]], s);
      pen.strokeStyle = pen.fillStyle = COLOURS[i];
      pen.lineWidth = 3;
      pen.beginPath();
      pen.moveTo(...start);
      pen.lineTo(...end);
      pen.stroke();
      pen.beginPath();
      [tip(10, 0), tip(0, 5), tip(0, -5)].forEach((corner) => pen.lineTo(...corner));
      pen.fill();
    }
    const [x, y] = drawn[0].start;
    pen.fillStyle = "#222";
    pen.beginPath();
    pen.arc(x, y, 5, 0, 2 * Math.PI);
    pen.fill();
    pen.fillText(handle.name, x, Math.min(...drawn.map(({ end }) => end[1])) - 18);
  }
}

/** The way from the grip's start that a ray asks for: along one axis, or in the screen's plane. */
function along(axis, center) {
  return ([eye, direction]) => {
    const [w, b] = [minus(center, eye), dot(axis, direction)];
    return plus([0, 0, 0], axis, (b * dot(direction, w) - dot(axis, w)) / (1 - b * b));
  };
}

function acrossScreen(axes, center) {
  const { back } = pose();
  return ([eye, direction]) => {
    const hit = plus(eye, direction, dot(minus(center, eye), back) / dot(direction, back));
    return minus(hit, center).map((x, i) => (axes[i] ? x : 0));
  };
}

/** The grip on the handle under a pixel; none where there is no handle. */
function gripAt(pixel) {
  for (const handle of state.handles ?? []) {
    const drawn = arrows(handle);
    let way;
    if (drawn.length > 1 && Math.hypot(...minus(pixel, drawn[0].start)) < REACH) {
      way = acrossScreen(handle.axes, handle.position);
    }
    for (const { axis, start, end } of way ? [] : drawn) {
      const line = minus(end, start);
      const t = Math.min(Math.max(dot(minus(pixel, start), line) / dot(line, line), 0), 1.1);
      if (Math.hypot(...minus(pixel, plus(start, line, t))) < REACH) way = along(axis, handle.position);
    }
    if (way) {
      const start = way(rayThrough(pixel));
      const from = handle.position;
      return { name: handle.name, position: from, follow: (ray) => plus(from, minus(way(ray), start)) };
    }
  }
}

const drag = (ends) => send({ handle: grip.name, position: grip.position, ends });

// -- pointer --------------------------------------------------------------------------------------

let pressed; // the last place of a pointer that turns or shifts the view
const placeOf = (event) => [event.offsetX, event.offsetY];

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
  } else if (pressed) {
    const [x, y] = minus(placeOf(event), pressed);
    pressed = placeOf(event);
    if (event.buttons & 1 && !event.shiftKey) {
      camera.azimuth -= x / 200;
      camera.elevation = Math.min(Math.max(camera.elevation + y / 200, -1.5), 1.5);
    } else {
      const { right, up } = pose();
      const metres = camera.distance / focalLength();
      camera.target = plus(plus(camera.target, right, -x * metres), up, y * metres);
    }
  }
  if (grip || pressed) redraw();
};
marks.onpointerup = marks.onpointercancel = () => {
  if (grip) drag(true);
  grip = pressed = undefined;
};
marks.onwheel = (event) => {
  event.preventDefault();
  camera.distance *= Math.exp(Math.sign(event.deltaY) * 0.1);
  redraw();
};
marks.oncontextmenu = (event) => event.preventDefault();

// Undo a move, but not what is being typed.
document.onkeydown = (event) => {
  const typing = event.target.type === "number";
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing) {
    event.preventDefault();
    send({ control: "undo", value: true });
  }
};

// -- frames ---------------------------------------------------------------------------------------

let waiting = false;

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
window.onresize = redraw;
connect();
