// --- samples between frames -----------------------------------------------------------------------------------------

function locate(times, t) {
  let a = 0, b = times.length - 1;
  while (b - a > 1) { const m = (a + b) >> 1; if (times[m] <= t) a = m; else b = m; }
  const width = times[b] - times[a];
  return [a, b, width > 0 ? Math.min(1, Math.max(0, (t - times[a]) / width)) : 0];
}
function sample(values, width, [a, b, w]) {
  const out = new Float64Array(width);
  for (let i = 0; i < width; i++) out[i] = (1 - w) * values[a * width + i] + w * values[b * width + i];
  return out;
}

// --- camera ---------------------------------------------------------------------------------------------------------

function project(x, y, z) {
  const [dx, dy, dz] = [(x - middle[0]) / size, (y - middle[1]) / size, (z - middle[2]) / size];
  const [c, s] = [Math.cos(eye.turn), Math.sin(eye.turn)], [p, q] = [Math.cos(eye.rise), Math.sin(eye.rise)];
  const right = c * dx + s * dy, away = c * dy - s * dx;
  const deep = p * away - q * dz, up = q * away + p * dz;
  const scale = Math.min(canvas.width, canvas.height) * LENS * eye.zoom / (eye.even ? DISTANCE : Math.max(DISTANCE + deep, 0.05));
  return [canvas.width / 2 + eye.shift[0] + scale * right, canvas.height / 2 + eye.shift[1] - scale * up, deep];
}

// --- drawing --------------------------------------------------------------------------------------------------------

function colour(value) {
  if (!Number.isFinite(value)) return "#9aa0a6";
  const u = Math.min(1, Math.max(0, (value - run.range[0]) / (run.range[1] - run.range[0]))) * (run.colours.length - 1);
  const i = Math.min(Math.floor(u), run.colours.length - 2), w = u - i;
  return `rgb(${run.colours[i].map((c, k) => Math.round((1 - w) * c + w * run.colours[i + 1][k])).join(",")})`;
}
function path(points, closed) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  if (closed) pen.closePath();
}
function bed() {
  const { points: n, x, y, z } = run.bed, cells = [];
  const at = (i, j) => project(x[i], y[j], z[i * n + j]);
  for (let i = 0; i + 1 < n; i++) for (let j = 0; j + 1 < n; j++) {
    const corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
    if (Math.min(...corners.map((c) => c[2])) < 0.3 - DISTANCE) continue;  // beside or behind the eye
    cells.push({ corners, deep: corners[0][2] + corners[2][2] });
  }
  cells.sort((a, b) => b.deep - a.deep);
  for (const { corners } of cells) {
    path(corners, true);
    pen.fillStyle = "rgba(216,203,180,0.45)"; pen.fill();
    pen.strokeStyle = "rgba(160,142,110,0.35)"; pen.lineWidth = 0.7 * ratio(); pen.stroke();
  }
}
function scale() {  // a bar in metres where every depth has one scale, else the width of a cell of the grid
  const [x, y] = [canvas.width - 150 * ratio(), canvas.height - 16 * ratio()];
  if (!eye.even) { if (state.cell) label(`grid ${plain(state.cell, 2)} m`, [x + 60 * ratio(), y]); return; }
  const metre = Math.min(canvas.width, canvas.height) * LENS * eye.zoom / DISTANCE / size, most = 130 * ratio() / metre;
  const power = 10 ** Math.floor(Math.log10(most)), length = [5, 2, 1].find((n) => n * power <= most) * power;
  pen.strokeStyle = "#2b2f33"; pen.lineWidth = 2 * ratio(); path([[x, y], [x + length * metre, y]]); pen.stroke();
  label(`${plain(length)} m`, [x, y - 5 * ratio()]);
}
function elevation(x, y) {
  const n = water.points, cell = water.x[1] - water.x[0], [a, b, w] = locate(water.time, state.now);
  const at = (i, j) => (1 - w) * water.elevation[(a * n + i) * n + j] + w * water.elevation[(b * n + i) * n + j];
  const inside = (v, first) => Math.min(n - 1.001, Math.max(0, (v - first) / cell));
  const [u, v] = [inside(x, water.x[0]), inside(y, water.y[0])], [i, j] = [Math.floor(u), Math.floor(v)];
  const mix = (k) => (1 - v + j) * at(k, j) + (v - j) * at(k, j + 1);
  return (1 - u + i) * mix(i) + (u - i) * mix(i + 1);
}
function buoy(r, { node, diameter, height, attachment }, dry) {
  const [x, y] = [r[3 * node], r[3 * node + 1]], foot = r[3 * node + 2] - attachment, sides = 20, half = diameter / 2;
  const top = foot + height, base = dry ? Math.max(foot, elevation(x, y)) : foot;
  if (base >= top) return;
  const ring = (z) => Array.from({ length: sides }, (_, i) => project(
    x + half * Math.cos(2 * Math.PI * i / sides), y + half * Math.sin(2 * Math.PI * i / sides), z));
  const [low, high] = [ring(base), ring(top)];
  pen.strokeStyle = "#2b2f33"; pen.lineWidth = 0.8 * ratio(); pen.fillStyle = "#e69f00";
  for (let i = 0; i < sides; i++) { const k = (i + 1) % sides; path([low[i], low[k], high[k], high[i]], true); pen.fill(); }
  const wide = [...low.keys()].sort((a, b) => low[a][0] - low[b][0]), [left, right] = [wide[0], wide[sides - 1]];
  path([low[left], high[left]]); pen.stroke(); path([low[right], high[right]]); pen.stroke();
  path(eye.rise < 0 ? high : low, true); pen.stroke();
  path(eye.rise < 0 ? low : high, true); pen.fillStyle = "#f0b93a"; pen.fill(); pen.stroke();
}
function turned(ring, body, frame) {  // places of a body's axes in the scene
  const count = bodies.names.length, all = sample(bodies.poses, 12 * count, frame).slice(12 * body, 12 * body + 12);
  return ring.map(([x, y, z]) => [0, 1, 2].map((i) => all[i] + all[3 + 3 * i] * x + all[4 + 3 * i] * y + all[5 + 3 * i] * z));
}
function hull(points) {  // of places on the screen, by Andrew's monotone chain
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]), half = (list) => {
    const kept = [];
    for (const p of list) {
      while (kept.length > 1) {
        const [a, b] = kept.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        kept.pop();
      }
      kept.push(p);
    }
    return kept.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}
function solid({ body, rings }, frame, dry) {
  let places = rings.map((ring) => turned(ring, body, frame));
  if (dry) {  // what stands out of the water: edges cut at the surface
    const out = ([x, y, z]) => z - elevation(x, y), cut = [];
    for (let k = 0; k + 1 < places.length; k++) places[k].forEach((a, i) => {
      const b = places[k + 1][i], [u, v] = [out(a), out(b)];
      if (u > 0) cut.push(a);
      if (v > 0) cut.push(b);
      if (u * v < 0) cut.push(a.map((p, j) => p + (b[j] - p) * u / (u - v)));
    });
    if (cut.length < 3) return;
    places = [cut];
  }
  pen.strokeStyle = "#2b2f33"; pen.lineWidth = 0.8 * ratio(); pen.fillStyle = "#e69f00";
  path(hull(places.flat().map((r) => project(...r))), true); pen.fill(); pen.stroke();
  if (dry || places.length !== 2) return;
  const near = places.map((ring) => ring.map((r) => project(...r)));
  const mean = (ring) => ring.reduce((sum, p) => sum + p[2], 0) / ring.length;
  const end = near[mean(near[0]) < mean(near[1]) ? 0 : 1];  // the end that faces the eye
  path(end, true); pen.fillStyle = "#f0b93a"; pen.fill(); pen.stroke();
}
function floor() {
  const step = 10 ** Math.floor(Math.log10(size)) * (size / 10 ** Math.floor(Math.log10(size)) > 4 ? 1 : 0.25);
  const z = water && middle[2] - water.depth < low[2] ? Math.max(-water.depth, low[2] - size) : low[2] - 0.04 * size;
  const reach = Math.ceil(0.75 * size / step) * step;
  const [x0, y0] = [Math.round(middle[0] / step) * step, Math.round(middle[1] / step) * step];
  pen.strokeStyle = "#e3e5e8"; pen.lineWidth = ratio();
  for (let d = -reach; d <= reach + 1e-9; d += step) {
    path([project(x0 + d, y0 - reach, z), project(x0 + d, y0 + reach, z)]); pen.stroke();
    path([project(x0 - reach, y0 + d, z), project(x0 + reach, y0 + d, z)]); pen.stroke();
  }
  state.cell = step;
}
function label(text, [x, y]) {
  pen.fillStyle = "#6b7076"; pen.font = `${12 * ratio()}px system-ui, sans-serif`; pen.fillText(text, x + 4 * ratio(), y);
  take(x + 4 * ratio(), y - 6 * ratio(), pen.measureText(text).width);
}
function take(left, middle, wide) {  // where a text stands, so that names stand elsewhere
  state.taken.push([left, middle - 7.5 * ratio(), left + wide, middle + 7.5 * ratio()]);
}
function on_screen([x, y, z]) {  // of a direction: to the right and up, for an eye far away
  const away = Math.cos(eye.turn) * y - Math.sin(eye.turn) * x;
  return [Math.cos(eye.turn) * x + Math.sin(eye.turn) * y, Math.sin(eye.rise) * away + Math.cos(eye.rise) * z];
}
function axes() {  // in the lower left corner, so that all three are in every view
  const from = [46 * ratio(), canvas.height - 34 * ratio()], long = 30 * ratio();
  ["x", "y", "z"].forEach((name, i) => {
    const [right, up] = on_screen([0, 1, 2].map((k) => Number(k === i)));
    if (Math.hypot(right, up) < 0.15) return;  // it points at the eye
    const tip = [from[0] + long * right, from[1] - long * up];
    pen.strokeStyle = "#2b2f33"; pen.lineWidth = 1.5 * ratio(); path([from, tip]); pen.stroke();
    label(name, [tip[0] + (8 * right - 7.5) * ratio(), tip[1] + (4 - 8 * up) * ratio()]);
  });
}
function flows() {  // arrows of waves and current in the lower right corner, as seen from here
  run.flows.forEach(({ text, direction, colour: ink }, i) => {
    const x = canvas.width - 34 * ratio(), y = canvas.height - (44 + 26 * (run.flows.length - 1 - i)) * ratio(), long = 20 * ratio();
    const [right, up] = on_screen([Math.cos(direction), Math.sin(direction), 0]), [dx, dy] = [long * right, -long * up];
    const tip = [x + dx, y + dy], turn = Math.atan2(dy, dx), wing = (a) => [tip[0] - 8 * ratio() * Math.cos(turn + a), tip[1] - 8 * ratio() * Math.sin(turn + a)];
    pen.strokeStyle = pen.fillStyle = ink; pen.lineWidth = 3 * ratio(); path([[x - dx, y - dy], tip]); pen.stroke();
    if (Math.hypot(dx, dy) > 3 * ratio()) { path([tip, wing(0.5), wing(-0.5)], true); pen.fill(); pen.stroke(); }
    pen.font = `${12 * ratio()}px system-ui, sans-serif`; pen.textAlign = "right"; pen.fillText(text, x - 28 * ratio(), y + 4 * ratio()); pen.textAlign = "left";
    const wide = pen.measureText(text).width; take(x - 28 * ratio() - wide, y, wide + 58 * ratio());
  });
}
function surface() {
  const n = water.points, eta = sample(water.elevation, n * n, locate(water.time, state.now));
  const at = (i, j) => project(water.x[i], water.y[j], eta[i * n + j]);
  const cells = [];
  for (let i = 0; i + 1 < n; i++) for (let j = 0; j + 1 < n; j++) {
    const corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
    const slope = (eta[(i + 1) * n + j] - eta[i * n + j] + eta[i * n + j + 1] - eta[i * n + j]) / (water.x[1] - water.x[0]);
    if (Math.min(...corners.map((c) => c[2])) < 0.3 - DISTANCE) continue;  // beside or behind the eye
    cells.push({ corners, deep: corners[0][2] + corners[2][2], shade: Math.max(-1, Math.min(1, 2 * slope)) });
  }
  cells.sort((a, b) => b.deep - a.deep);
  for (const { corners, shade } of cells) {
    path(corners, true);
    pen.fillStyle = `rgba(${86 + 45 * shade},${180 + 30 * shade},${225 + 15 * shade},0.16)`; pen.fill();
    pen.strokeStyle = "rgba(40,120,170,0.22)"; pen.lineWidth = 0.7 * ratio(); pen.stroke();
  }
}
function trail(frame) {
  pen.lineWidth = 2.5 * ratio(); pen.lineJoin = "round";
  const from = locate(time, state.now - TRAIL * (end - start))[0], node = picked.node !== null ? picked.node : run.buoys.length ? run.buoys[0].node : Math.floor(nodes / 2), points = [];
  for (let k = from; k <= frame[0]; k++) points.push(project(...place.subarray(3 * (k * nodes + node), 3 * (k * nodes + node) + 3)));
  points.push(project(...sample(place, 3 * nodes, frame).subarray(3 * node, 3 * node + 3)));
  pen.strokeStyle = "#d55e00"; path(points); pen.stroke();
}
function line(frame) {
  const r = sample(place, 3 * nodes, frame), pull = sample(tension, links, frame);
  const points = Array.from({ length: nodes }, (_, i) => project(r[3 * i], r[3 * i + 1], r[3 * i + 2]));
  const depth = (j) => points[run.first[j]][2] + points[run.first[j] + 1][2];
  const order = Array.from({ length: links }, (_, j) => j).sort((a, b) => depth(b) - depth(a));
  pen.lineCap = "round";
  if (!solids) for (const j of order) {
    path([points[run.first[j]], points[run.first[j] + 1]]);
    pen.lineWidth = (nodes > 200 ? 3 : 5) * ratio(); pen.strokeStyle = colour(pull[j]); pen.stroke();
  }
  const dot = nodes > 60 || solids ? 0 : 3 * ratio();
  points.forEach(([x, y], i) => {
    if (run.held.includes(i)) {
      const h = 6 * ratio(); pen.fillStyle = "#2b2f33"; pen.fillRect(x - h, y - h, 2 * h, 2 * h);
    } else if (run.joints.includes(i)) {
      const h = (solids ? 3.5 : 5) * ratio(); pen.fillStyle = "#e69f00"; path([[x - h, y], [x, y - h], [x + h, y], [x, y + h]], true); pen.fill();
    } else if (dot) { pen.beginPath(); pen.arc(x, y, dot, 0, 7); pen.fillStyle = "#2b2f33"; pen.fill(); }
  });
  if (!solids) [...run.buoys].sort((a, b) => points[b.node][2] - points[a.node][2]).forEach((one) => buoy(r, one));
  if (bodies && !solids) bodies.shapes.forEach((one) => solid(one, frame));
  return { points, pull, r };
}
function tell({ points, pull, r }) {
  const tip = byId("tip"); tip.hidden = true;
  if (!state.mouse) return;
  const [mx, my] = state.mouse.map((v) => v * ratio());
  const found = nearest(points, mx, my, 7 * ratio());
  if (!found) return;
  const at = r.subarray(3 * found.node, 3 * found.node + 3);
  tip.textContent = `${run.parts[found.link]}: ${force(pull[found.link])}; node at ${[...at].map((v) => v.toFixed(2)).join(", ")} m`; tip.hidden = false;
  tip.style.left = `${state.mouse[0] + 14}px`; tip.style.top = `${state.mouse[1] + 6}px`;
}
function ratio() { return window.devicePixelRatio || 1; }
function measure() {
  const [w, h] = [Math.round(canvas.clientWidth * ratio()), Math.round(canvas.clientHeight * ratio())];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  return [w, h];
}
function fit() {  // zoom and shift with which the lines, over the whole run, fill the picture
  const [w, h] = measure(), box = [Infinity, Infinity, -Infinity, -Infinity];
  Object.assign(eye, { zoom: 1, shift: [0, 0] });
  const see = (r) => { const [x, y] = project(...r); box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y); box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y); };
  for (let k = 0; k < run.frames; k += Math.ceil(run.frames / 40)) {
    for (let i = 0; i < nodes; i++) see(place.subarray(3 * (k * nodes + i), 3 * (k * nodes + i) + 3));
    for (const { node, height, attachment } of run.buoys) { const r = place.subarray(3 * (k * nodes + node), 3 * (k * nodes + node) + 3); see([r[0], r[1], r[2] - attachment + height]); }
  }
  if (bodies) for (const z of [low[2], high[2]]) see([middle[0], middle[1], z]);
  eye.zoom = Math.min(30, 0.76 * w / Math.max(box[2] - box[0], 1), 0.7 * h / Math.max(box[3] - box[1], 1));
  eye.shift = [eye.zoom * (w / 2 - (box[0] + box[2]) / 2), eye.zoom * (h / 2 - (box[1] + box[3]) / 2) + 0.03 * h];
  state.fitted = JSON.stringify(eye);
}
function draw() {
  const [w, h] = measure();
  if (!w || !h) return;
  pen.clearRect(0, 0, w, h);
  state.taken = [...document.querySelectorAll("header, #legend")].map((one) => {
    const { left, top, right, bottom } = one.getBoundingClientRect();
    return [left, top, right, bottom].map((v) => v * ratio());
  });
  const frame = locate(time, state.now), wet = water && byId("water").checked;
  if (solids) {
    if (!run.bed) floor();
    pen.drawImage(solids.render(sample(place, 3 * nodes, frame), sample(tension, links, frame), frame, wet), 0, 0);
  } else if (run.bed) bed(); else floor();
  scale();
  axes();
  flows();
  if (!solids && wet && eye.rise < 0) surface();  // seen from below, the surface lies behind the line
  const drawn = line(frame);
  if (byId("trail").checked) trail(frame);
  if (!solids && wet && eye.rise >= 0) {
    surface();
    run.buoys.forEach((one) => buoy(drawn.r, one, true));  // what stands out of the water hides it
    if (bodies) bodies.shapes.forEach((one) => solid(one, frame, true));
  }
  if (byId("names").checked) names(drawn.points);
  if (byId("ruler").checked) ruler(drawn);
  state.points = drawn.points;
  tell(drawn); trace(); tell_other();
  byId("clock").textContent = `${clock(state.now)} / ${clock(end)} s`;
  byId("scrub").value = state.now;
  Object.assign(document.body.dataset, { time: state.now.toFixed(4), playing: state.playing, turn: eye.turn.toFixed(3), ready: 1 });
}

// --- controls -------------------------------------------------------------------------------------------------------

function tick(stamp) {
  if (!state.playing) return;
  const passed = state.last ? (stamp - state.last) / 1000 : 0;
  state.last = stamp;
  state.now += passed * Number(byId("speed").value);
  if (state.now >= end) state.now = start;
  draw();
  requestAnimationFrame(tick);
}
function play(on) {
  state.playing = on; state.last = 0;
  byId("play").textContent = on ? "pause" : "play";
  draw();
  if (on) requestAnimationFrame(tick);
}
function look(name) {
  [eye.turn, eye.rise] = VIEWS[name]; eye.even = name !== "free"; fit(); draw();
}
function pinch() {  // distance and middle of two fingers
  const [a, b] = [...state.fingers.values()];
  return { wide: Math.hypot(a[0] - b[0], a[1] - b[1]), at: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] };
}
function zoom(factor) {
  const held = Math.min(30, Math.max(0.2, eye.zoom * factor)) / eye.zoom;
  eye.zoom *= held; eye.shift = eye.shift.map((v) => v * held);
}
canvas.addEventListener("pointerdown", (e) => { if (e.isTrusted) canvas.setPointerCapture(e.pointerId); canvas.classList.add("held"); state.grip = [e.clientX, e.clientY]; state.from = [e.clientX, e.clientY]; state.fingers.set(e.pointerId, [e.clientX, e.clientY]); if (state.fingers.size > 1) state.from = null; });
canvas.addEventListener("pointerup", (e) => {  // a press that did not drag
  if (!state.from || !state.points || Math.hypot(e.clientX - state.from[0], e.clientY - state.from[1]) > 4) return;
  const edge = canvas.getBoundingClientRect();
  const found = nearest(state.points, (e.clientX - edge.left) * ratio(), (e.clientY - edge.top) * ratio(), 9 * ratio());
  if (!byId("ruler").checked) pick(found);
  else if (found) { picked.ends = [...picked.ends, found.node].slice(-2); draw(); }
});
canvas.addEventListener("pointermove", (e) => {
  state.mouse = [e.offsetX, e.offsetY];
  if (state.fingers.size === 2 && state.fingers.has(e.pointerId)) {  // two fingers zoom and move
    const before = pinch();
    state.fingers.set(e.pointerId, [e.clientX, e.clientY]);
    const { wide, at } = pinch();
    zoom(wide / Math.max(before.wide, 1));
    eye.shift = eye.shift.map((v, i) => v + (at[i] - before.at[i]) * ratio());
  } else if (state.grip) {
    const [dx, dy] = [e.clientX - state.grip[0], e.clientY - state.grip[1]];
    state.grip = [e.clientX, e.clientY];
    if (e.shiftKey) eye.shift = [eye.shift[0] + dx * ratio(), eye.shift[1] + dy * ratio()];
    else { eye.even = false; eye.turn -= 0.008 * dx; eye.rise = Math.min(1.57, Math.max(-1.57, eye.rise + 0.008 * dy)); }
  }
  draw();
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (e) => { state.fingers.delete(e.pointerId); state.grip = [...state.fingers.values()][0] || null; canvas.classList.remove("held"); });
canvas.addEventListener("dblclick", () => { fit(); draw(); });
canvas.addEventListener("pointerleave", () => { state.mouse = null; draw(); });
canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(-0.0012 * e.deltaY)); draw(); }, { passive: false });
byId("play").addEventListener("click", () => play(!state.playing));
byId("scrub").addEventListener("input", (e) => { state.now = Number(e.target.value); draw(); });
byId("fit").addEventListener("click", () => { fit(); draw(); });
byId("save").addEventListener("click", save_picture);
byId("share").addEventListener("click", share);
byId("part-save").addEventListener("click", save_curve);
byId("part-close").addEventListener("click", () => pick(null));
for (const id of ["trail", "water", "names", "ruler"]) byId(id).addEventListener("change", draw);
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
addEventListener("keydown", (e) => {
  if (["INPUT", "SELECT", "BUTTON"].includes(e.target.tagName)) return;
  const step = (end - start) / Math.max(run.frames - 1, 1);
  if (e.key === "Escape") pick(null);
  if (e.key === " ") { e.preventDefault(); play(!state.playing); }
  if (e.key === "ArrowRight") { state.now = Math.min(end, state.now + step); draw(); }
  if (e.key === "ArrowLeft") { state.now = Math.max(start, state.now - step); draw(); }
});
function resized() {
  if (JSON.stringify(eye) === state.fitted) fit();
  raise_part(); draw();
}
addEventListener("resize", resized);
const opened = () => document.querySelector("footer").classList.contains("open");
function open_options(on) {
  document.querySelector("footer").classList.toggle("open", on); byId("more").setAttribute("aria-expanded", on); resized();
}
byId("more").addEventListener("click", () => open_options(!opened()));
addEventListener("hashchange", follow);

byId("name").textContent = run.name;
byId("how").textContent = [run.how, ...run.notes].join("; ");
byId("description").textContent = run.description;
byId("names").checked = run.lines.length > 1 && run.lines.length <= 40;
byId("named").hidden = run.lines.length < 2;
byId("how").classList.toggle("bad", !run.ok);
byId("sea").hidden = !water;
const beyond = run.largest > run.range[1];
const largest = beyond ? `, maximum ${plain(run.largest / (KILO ? 1000 : 1))}` : "";
byId("unit").textContent = `tension [${KILO ? "kN" : "N"}]${largest}`;
byId("high").textContent = (beyond ? "\u2265 " : "") + plain(run.range[1] / (KILO ? 1000 : 1));
byId("low").textContent = Math.abs(run.range[0]) < 0.005 * run.range[1] ? "0" : plain(run.range[0] / (KILO ? 1000 : 1));
byId("mid").textContent = plain((run.range[0] + run.range[1]) / 2 / (KILO ? 1000 : 1));
Object.assign(byId("scrub"), { min: start, max: end });
const bar = byId("bar").getContext("2d");
for (let y = 0; y < 160; y++) { bar.fillStyle = colour(run.range[1] + (y / 159) * (run.range[0] - run.range[1])); bar.fillRect(0, y, 14, 1); }
bar.fillStyle = "#ffffff"; bar.fillRect(0, 80, 5, 1);
if (run.bed) state.cell = run.bed.x[1] - run.bed.x[0];
if (window.name === "second") document.body.classList.add("led");  // of two runs the first has the controls
fit(); draw(); follow();
