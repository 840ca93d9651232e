// A click on a part: its tension over time in a panel, and the trail of its nearer node. Names, and numbers for people.
const picked = { link: null, node: null, other: null, ends: [] };  // other: the same part of the other run; ends: of the ruler
const KILO = Math.max(Math.abs(run.range[0]), Math.abs(run.range[1])) >= 5000;
function plain(value, digits = 3) {  // no powers of ten: 12345 is 12300, 0.00123 is 0.00123
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value), places = size > 0 ? Math.max(0, digits - 1 - Math.floor(Math.log10(size))) : 0;
  return places > 6 ? "0" : String(+value.toFixed(places));
}
const force = (value) => (Math.abs(value) >= 1000 ? `${plain(value / 1000)} kN` : `${plain(value)} N`);
function clock(seconds, digits = 2) {
  if (end < 600) return seconds.toFixed(digits);
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, seconds % 60];
  return `${end >= 3600 ? `${h}:${String(m).padStart(2, "0")}` : Math.floor(seconds / 60)}:${s.toFixed(1).padStart(4, "0")}`;
}
function nearest(points, x, y, reach) {  // link and node under a place on the screen
  let best = null;
  for (let j = 0; j < links; j++) {
    const [a, b] = [points[run.first[j]], points[run.first[j] + 1]], [dx, dy] = [b[0] - a[0], b[1] - a[1]];
    const u = Math.min(1, Math.max(0, ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy || 1)));
    const off = Math.hypot(a[0] + u * dx - x, a[1] + u * dy - y);
    if (off <= reach && (!best || off < best.off)) best = { off, link: j, node: run.first[j] + (u > 0.5 ? 1 : 0) };
  }
  return best;
}
function pick(found) {
  picked.link = found ? found.link : null; picked.node = found ? found.node : picked.node;
  picked.other = null; byId("part-other").textContent = "";
  byId("part").hidden = !found;
  if (found) {
    let [least, largest, sum] = [Infinity, -Infinity, 0];
    for (let k = 0; k < run.frames; k++) { const v = tension[k * links + found.link]; least = Math.min(least, v); largest = Math.max(largest, v); sum += v; }
    Object.assign(picked, { least, largest });
    raise_part();
    byId("part-name").textContent = run.parts[found.link];
    byId("part-range").textContent = `${force(least)} to ${force(largest)}, mean ${force(sum / run.frames)}`;
    document.body.dataset.picked = run.labels[found.link];
    if (window.parent !== window) send({ wants: run.labels[found.link] });
  } else delete document.body.dataset.picked;
  draw();
}
function raise_part() { byId("part").style.bottom = `${document.querySelector("footer").offsetHeight + 12}px`; }
const tension_of = (link) => Float32Array.from(time, (_, k) => tension[k * links + link]);
function other_at(t) {  // tension of the picked part in the other run
  const [a, b, w] = locate(picked.other.time, t);
  return (1 - w) * picked.other.tension[a] + w * picked.other.tension[b];
}
function compare(other) {  // the picked part in the other run: its range, and the largest difference from this run
  picked.other = other;
  const apart = Math.max(...tension_of(picked.link).map((v, k) => Math.abs(v - other_at(time[k]))));
  const [least, largest] = [Math.min(...other.tension), Math.max(...other.tension)];
  Object.assign(picked, { least: Math.min(picked.least, least), largest: Math.max(picked.largest, largest) });
  byId("part-other").textContent = `other run ${force(least)} to ${force(largest)}, up to ${force(apart)} apart`;
  draw();
}
function ruler({ points, r }) {  // between the nodes of the last two clicks
  pen.strokeStyle = pen.fillStyle = "#7b2d8b"; pen.lineWidth = 2 * ratio();
  for (const node of picked.ends) { pen.beginPath(); pen.arc(...points[node].slice(0, 2), 5 * ratio(), 0, 7); pen.stroke(); }
  if (picked.ends.length < 2) return;
  const [a, b] = picked.ends, [p, q] = [points[a], points[b]], [x, y, z] = [0, 1, 2].map((i) => r[3 * b + i] - r[3 * a + i]);
  pen.setLineDash([6 * ratio(), 4 * ratio()]); path([p, q]); pen.stroke(); pen.setLineDash([]);
  const text = `${plain(Math.hypot(x, y, z), 4)} m (${[x, y, z].map((v) => v.toFixed(2)).join(", ")})`;
  pen.font = `bold ${12 * ratio()}px system-ui, sans-serif`;
  const [left, top, wide] = [(p[0] + q[0]) / 2 + 6 * ratio(), (p[1] + q[1]) / 2, pen.measureText(text).width + 8 * ratio()];
  pen.fillStyle = "rgba(255,255,255,0.85)"; pen.fillRect(left, top - 13 * ratio(), wide, 17 * ratio());
  pen.fillStyle = "#7b2d8b"; pen.fillText(text, left + 4 * ratio(), top); document.body.dataset.ruler = text;
}
// the address of a view: run, time, camera (shift in units of the picture's smaller side) and part
const SHARED = ["turn", "rise", "zoom"];
const smaller = () => Math.min(canvas.width, canvas.height);
function share() {
  const page = window.parent.location, words = new URLSearchParams({ run: run.name, t: state.now.toFixed(3) });
  for (const key of SHARED) words.set(key, eye[key].toFixed(4));
  words.set("shift", eye.shift.map((v) => (v / smaller()).toFixed(4)).join(" ")); words.set("even", Number(eye.even));
  if (picked.link !== null) words.set("part", run.labels[picked.link]);
  page.hash = words;
  const says = (text) => { byId("share").textContent = text; setTimeout(() => { byId("share").textContent = "link"; }, 2000); };
  if (!navigator.clipboard) { says("see address"); return; }
  navigator.clipboard.writeText(String(page)).then(() => says("copied"), () => says("see address"));
}
function follow() {
  const words = new URLSearchParams(window.parent.location.hash.slice(1)), number = (key) => Number(words.get(key));
  if (!words.has("t")) return;
  state.now = Math.min(end, Math.max(start, number("t")));
  for (const key of SHARED) if (words.has(key)) eye[key] = number(key);
  eye.shift = (words.get("shift") || "0 0").split(" ").map((v) => Number(v) * smaller()); eye.even = words.get("even") === "1";
  const link = window.name === "second" ? -1 : run.labels.indexOf(words.get("part"));
  if (link >= 0) pick({ link, node: run.first[link] }); else draw();
}
function trace() {  // tension of the picked link over time, least and largest of every column of pixels
  if (picked.link === null) return;
  const sheet = byId("trace"), ink = sheet.getContext("2d"), w = sheet.width = Math.round(sheet.clientWidth * ratio()) || 320, h = sheet.height = Math.round(sheet.clientHeight * ratio()) || 110;
  const { least, largest, link } = picked, span = largest - least || Math.abs(largest) || 1, foot = 14 * ratio(), top = 8 * ratio(), left = 46 * ratio();
  const x = (t) => left + (t - start) / (end - start || 1) * (w - left - 2), y = (v) => h - foot - (v - least) / span * (h - foot - top);
  ink.font = `${11 * ratio()}px system-ui, sans-serif`; ink.lineWidth = ratio(); ink.textAlign = "right";
  for (const v of new Set([least, (least + largest) / 2, largest])) {  // its axis
    ink.strokeStyle = "#dcdfe3"; ink.beginPath(); ink.moveTo(left, y(v)); ink.lineTo(w, y(v)); ink.stroke();
    ink.fillStyle = "#5f6368"; ink.fillText(force(v), left - 3 * ratio(), y(v) + 4 * ratio());
  }
  ink.textAlign = "left"; ink.lineWidth = 1.1 * ratio();
  const curve = (times, values, colour) => {
    ink.strokeStyle = colour; ink.beginPath();
    let column = null, low = 0, high = 0;
    values.forEach((v, k) => {
      if (times[k] < start || times[k] > end) return;
      const at = Math.round(x(times[k]));
      if (at === column) { low = Math.min(low, v); high = Math.max(high, v); } else { [column, low, high] = [at, v, v]; }
      ink.lineTo(at, y(high)); if (low !== high) ink.lineTo(at, y(low));
    });
    ink.stroke();
  };
  if (picked.other) curve(picked.other.time, picked.other.tension, "#d55e00");
  curve(time, tension_of(link), "#0072b2");
  ink.strokeStyle = "#b00020"; ink.beginPath(); ink.moveTo(x(state.now), top); ink.lineTo(x(state.now), h - foot); ink.stroke();
  ink.fillStyle = "#5f6368"; ink.fillText(`${clock(start, 0)} s`, left, h - 2); ink.textAlign = "right"; ink.fillText(`${clock(end, 0)} s`, w - 2, h - 2);
  ink.textAlign = "left"; ink.fillText(force(tension[locate(time, state.now)[0] * links + link]), Math.min(x(state.now) + 4, w - 60 * ratio()), top + 9 * ratio());
}
function save(name, blob) {
  const place = URL.createObjectURL(blob), download = `${run.name}-${name}`.replace(/[^\w.-]+/g, "-");
  Object.assign(document.createElement("a"), { href: place, download }).click();
  setTimeout(() => URL.revokeObjectURL(place), 1000);
}
function save_curve() {
  const both = picked.other !== null, rows = Array.from(time, (t, k) => `${t},${tension[k * links + picked.link]}${both ? `,${other_at(t)}` : ""}`);
  const head = `time_s,tension_n${both ? ",tension_other_run_n" : ""}`;
  save(`${run.parts[picked.link]}.csv`, new Blob([[head, ...rows, ""].join("\n")], { type: "text/csv" }));
}
function save_picture() {  // the canvas with title, time and colour bar, which are elements of their own on the page
  const sheet = document.createElement("canvas"), ink = sheet.getContext("2d"), w = sheet.width = canvas.width, u = ratio();
  sheet.height = canvas.height;
  ink.fillStyle = "#ffffff"; ink.fillRect(0, 0, w, sheet.height); ink.drawImage(canvas, 0, 0);
  ink.fillStyle = "#2b2f33"; ink.font = `bold ${16 * u}px system-ui, sans-serif`;
  ink.fillText(`${run.name}, t = ${clock(state.now)} s`, 18 * u, 26 * u);
  ink.font = `${12 * u}px system-ui, sans-serif`; ink.textAlign = "right"; ink.fillText(byId("unit").textContent, w - 18 * u, 26 * u);
  ink.drawImage(byId("bar"), w - 32 * u, 38 * u, 14 * u, 160 * u);
  ["high", "mid", "low"].forEach((id, i) => ink.fillText(byId(id).textContent, w - 40 * u, (48 + 74 * i) * u));
  sheet.toBlob((blob) => save(`${state.now.toFixed(2)}s.png`, blob));
}
function names(points) {  // beside the middle of each line, on the side where there is room and no other text
  const { taken } = state, high = 15 * ratio();
  pen.font = `${12 * ratio()}px system-ui, sans-serif`; pen.textBaseline = "middle";
  for (const { name, node } of run.lines) {
    const [x, y] = points[node], wide = pen.measureText(name).width + 8 * ratio();
    const boxes = [x + 8 * ratio(), x - 8 * ratio() - wide].map((left) => [left, y - high / 2, left + wide, y + high / 2]);
    const box = boxes.find((b) => b[0] >= 0 && b[1] >= 0 && b[2] <= canvas.width && b[3] <= canvas.height
      && !taken.some((t) => t[0] < b[2] && b[0] < t[2] && t[1] < b[3] && b[1] < t[3]));
    if (!box) continue;
    taken.push(box);
    pen.fillStyle = "rgba(255,255,255,0.78)"; pen.fillRect(box[0], box[1], wide, high);
    pen.fillStyle = "#2b2f33"; pen.fillText(name, box[0] + 4 * ratio(), y);
  }
  pen.textBaseline = "alphabetic";
}
