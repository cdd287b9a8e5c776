"use strict";
const element = (id) => document.getElementById(id);
const viewer = new MeshCat.Viewer(element("meshcat-pane"));
const animator = viewer.animator;

// ---- the scene

function complain(text) {
  const note = element("note");
  note.style.display = "block";
  note.appendChild(document.createElement("div")).textContent = text;
}

async function unpack() {
  const compressed = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  for (const place of commands) {
    let size = 0;
    for (let i = 0; i < place.length; i += 2) size += place[i + 1] - place[i];
    const command = new Uint8Array(size);
    for (let i = 0, at = 0; i < place.length; at += place[i + 1] - place[i], i += 2) {
      command.set(bytes.subarray(place[i], place[i + 1]), at);
    }
    // What one command cannot do must not keep the others from being carried out.
    try {
      viewer.handle_command_bytearray(command);
    } catch (error) {
      complain("not drawn: " + new TextDecoder().decode(command.subarray(0, 200)).replace(/[^ -~]+/g, " ") + ": " + error);
    }
  }
}

// Images of meshes come in later than the meshes; the viewer would show them with the next movement only.
async function redrawWithImages() {
  const lacksImage = (object) => [object.material].flat().some((m) => m && m.map && !m.map.image);
  for (let tries = 0; tries < 200; tries += 1) {
    let lacking = false;
    viewer.scene.traverse((object) => { lacking = lacking || lacksImage(object); });
    if (!lacking) break;
    await new Promise((done) => setTimeout(done, 50));
  }
  viewer.set_dirty();
}

// The camera was placed for a wide window with a low bar; another one sees as much from further away.
let further = 1;
function fitCamera() {
  const pane = element("meshcat-pane");
  const free = 2 * element("bar").getBoundingClientRect().top / pane.clientHeight - 1;
  const wanted = Math.max(1, info.aspect / (pane.clientWidth / pane.clientHeight), info.height / Math.max(free, 0.2));
  viewer.camera.position.multiplyScalar(wanted / further);
  further = wanted;
  viewer.controls.update();
  viewer.set_dirty();
}

// The plots stand beside the scene where there is room for both.
function layOut() {
  document.body.classList.toggle("beside", element("plots").open && window.innerWidth > 900);
  viewer.set_3d_pane_size();
  fitCamera();
  drawPlots();
  labelTicks();
}

// ---- the bar

const slider = element("time");
slider.max = info.duration;
slider.step = info.duration / 10000;
for (const [time, contact, kind] of info.events) {
  const tick = document.createElement("button");
  tick.title = (contact ? contact + ": " : "") + kind + ", t = " + time.toFixed(4) + " s";
  tick.setAttribute("aria-label", tick.title);
  tick.style.left = (100 * (time - info.start)) / info.duration + "%";
  tick.addEventListener("click", () => { run(false); seek(time - info.start); });
  element("ticks").appendChild(tick);
}

// Labels where there is room for them; the rest have their tooltips.
function labelTicks() {
  const ticks = element("ticks");
  ticks.querySelectorAll("span").forEach((label) => label.remove());
  let free = -Infinity;
  for (const [time, contact, kind] of info.events) {
    const label = document.createElement("span");
    label.textContent = info.contacts.length > 1 && contact ? contact + " " + kind : kind;
    label.style.left = (100 * (time - info.start)) / info.duration + "%";
    ticks.appendChild(label);
    const { left, right } = label.getBoundingClientRect(), ends = ticks.getBoundingClientRect();
    // centred on its mark, but within the slider
    const shift = Math.max(0, ends.left - left) - Math.max(0, right - ends.right);
    label.style.marginLeft = shift + "px";
    if (left + shift < free) label.remove(); else free = right + shift + 6;
  }
}

const speeds = [0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];
if (!speeds.includes(info.speed)) speeds.push(info.speed);
for (const value of speeds.sort((a, b) => a - b)) {
  element("speed").add(new Option(value + "\u00d7", value, false, value === info.speed));
}
const applySpeed = () => { animator.mixer.timeScale = Number(element("speed").value); };
element("speed").addEventListener("change", applySpeed);

// ---- contacts

function span(className, parent) {
  const made = document.createElement("span");
  made.className = className;
  return parent.appendChild(made);
}
const rows = info.contacts.map((contact) => {
  const row = element("contacts").querySelector("table").insertRow();
  const head = document.createElement("th");
  span("line", head).style.background = contact.color;
  head.append(contact.name);
  head.title = "the arrows show the force on " + contact.on;
  row.appendChild(head);
  const mode = row.insertCell();
  const swatch = span("swatch", mode), word = span("", mode);
  const normal = row.insertCell(), friction = row.insertCell(), on = row.insertCell();
  normal.className = friction.className = "number";
  on.className = "on";
  on.textContent = "on " + contact.on;
  return { row, contact, swatch, word, normal, friction };
});
if (rows.length === 0) element("contacts").style.display = element("plots").style.display = "none";

function show(time) {
  slider.value = time;
  element("clock").textContent = "t = " + (info.start + time).toFixed(3) + " s";
  const frame = Math.max(0, Math.min(info.frames - 1, Math.floor(time / info.step + 1e-6)));
  let closed = 0;
  for (const row of rows) {
    const mode = row.contact.mode[frame];
    const open = mode === info.open;
    if (!open) closed += 1;
    // Many open contacts would fill the screen with zeros.
    row.row.style.display = open && rows.length > 4 ? "none" : "";
    row.word.textContent = info.modes[mode].name;
    row.swatch.style.background = info.modes[mode].color;
    row.normal.textContent = "N = " + row.contact.normal[frame].toPrecision(4) + " N";
    row.friction.textContent = "T = " + row.contact.friction[frame].toPrecision(4) + " N";
  }
  element("contacts").querySelector("summary").textContent =
    rows.length === 1 ? "contact" : closed + " of " + rows.length + " contacts closed";
  drawCursor(time);
}

// ---- plots: normal force (full line), friction (dotted), friction limit (dashed), of each contact in its colour

const canvas = element("plots").querySelector("canvas");
const picture = document.createElement("canvas");
const margin = { left: 46, right: 8, top: 22, bottom: 22 };
let scale = 1;

function number(value) { return Number(value.toPrecision(3)).toString(); }

function drawPlots() {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (!element("plots").open || width === 0) return;
  for (const c of [canvas, picture]) { c.width = width * ratio; c.height = height * ratio; }
  scale = ratio;
  const pen = picture.getContext("2d");
  pen.scale(ratio, ratio);
  const wide = width - margin.left - margin.right, high = height - margin.top - margin.bottom;
  const all = info.contacts.flatMap((c) => [c.normal, c.friction, c.limit || []]).flat();
  const top = all.reduce((a, b) => Math.max(a, b), 0) * 1.05 || 1;
  const x = (i) => margin.left + (wide * i) / Math.max(1, info.frames - 1);
  const y = (value) => margin.top + high * (1 - value / top);
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = "#1d2733";
  pen.strokeStyle = "#d5dae0";
  for (let k = 0; k <= 4; k += 1) {
    const level = (top * k) / 4;
    pen.beginPath(); pen.moveTo(margin.left, y(level)); pen.lineTo(width - margin.right, y(level)); pen.stroke();
    pen.textAlign = "right"; pen.fillText(number(level), margin.left - 4, y(level) + 4);
    pen.textAlign = k === 4 ? "right" : "center";
    pen.fillText(number(info.start + (info.duration * k) / 4), margin.left + (wide * k) / 4, height - 6);
  }
  pen.textAlign = "left";
  pen.fillText("force [N] over t [s]; friction dotted, its limit dashed", margin.left, 12);
  const line = (values, color, dash) => {
    pen.beginPath();
    pen.setLineDash(dash);
    pen.strokeStyle = color;
    values.forEach((value, i) => (i === 0 ? pen.moveTo(x(i), y(value)) : pen.lineTo(x(i), y(value))));
    pen.stroke();
  };
  pen.lineWidth = 1.5;
  for (const contact of info.contacts) {
    line(contact.normal, contact.color, []);
    line(contact.friction, contact.color, [2, 3]);
    if (contact.limit) line(contact.limit, contact.color, [7, 4]);
  }
  drawCursor(Number(slider.value));
}

function drawCursor(time) {
  if (!element("plots").open || picture.width === 0) return;
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.drawImage(picture, 0, 0);
  const wide = canvas.width / scale - margin.left - margin.right;
  const x = (margin.left + (wide * time) / info.duration) * scale;
  pen.strokeStyle = "#1d2733";
  pen.beginPath(); pen.moveTo(x, 0); pen.lineTo(x, canvas.height - margin.bottom * scale); pen.stroke();
}

function seekInPlot(event) {
  if (event.buttons !== 1) return;
  const wide = canvas.clientWidth - margin.left - margin.right;
  run(false);
  seek(Math.max(0, Math.min(1, (event.offsetX - margin.left) / wide)) * info.duration);
}
canvas.addEventListener("pointerdown", seekInPlot);
canvas.addEventListener("pointermove", seekInPlot);
element("plots").addEventListener("toggle", layOut);
window.addEventListener("resize", layOut);

// ---- playing

let running = false;
function run(on) {
  running = on;
  if (running) animator.play(); else animator.pause();
  element("play").textContent = running ? "pause" : "play";
}
function seek(time) {
  animator.seek(time);
  animator.display_progress(time);
  show(time);
}
element("play").addEventListener("click", () => run(!running));
slider.addEventListener("input", () => { run(false); seek(Number(slider.value)); });
document.addEventListener("keydown", (event) => {
  if (event.code === "Space" && event.target === document.body) { event.preventDefault(); run(!running); }
});
function follow() {
  requestAnimationFrame(follow);
  // The scrubber and buttons of meshcat's own panel may have moved the animation, too.
  if (animator.playing !== running) {
    if (running && element("loop").checked) run(true);
    else { running = animator.playing; element("play").textContent = running ? "pause" : "play"; }
  }
  if (Number(slider.value) !== animator.time) show(animator.time);
}

const ready = unpack().then(() => {
  viewer.gui.close();
  applySpeed();
  // A long list would hide the scene; its heading says how many are closed.
  element("contacts").open = rows.filter((row) => row.contact.mode[0] !== info.open).length <= 6;
  element("plots").open = window.innerWidth > 900 && rows.length > 0;
  // The camera has just been placed; a window that changed its size before has moved none.
  further = 1;
  layOut();
  run(true);
  // "page.html#t=1.5" opens the page paused at that time.
  const wanted = /[#&]t=([-+.0-9e]+)/.exec(location.hash);
  if (wanted) {
    run(false);
    seek(Math.max(0, Math.min(info.duration, Number(wanted[1]) - info.start)));
  } else {
    show(0);
  }
  follow();
  return redrawWithImages();
}).catch((error) => { complain("this page needs a browser with DecompressionStream: " + error); });
