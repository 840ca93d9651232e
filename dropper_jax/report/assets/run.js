"use strict";
const byId = (id) => document.getElementById(id);
const run = JSON.parse(byId("data").textContent);
const unpack = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const time = unpack(run.time), place = unpack(run.positions), tension = unpack(run.tension);
const steps = (text, step) => Float32Array.from(new Int16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer), (v) => v * step);
const water = run.water && { ...run.water, time: unpack(run.water.time), elevation: steps(run.water.elevation, run.water.step) };
const nodes = run.nodes, links = run.first.length, start = time[0], end = time[run.frames - 1];
const canvas = byId("scene"), pen = canvas.getContext("2d");

const bodies = run.bodies && { ...run.bodies, poses: unpack(run.bodies.poses) };

// the motion's box: the camera looks at its middle from far enough to see all of it
const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
for (let i = 0; i < place.length; i++) {
  low[i % 3] = Math.min(low[i % 3], place[i]);
  high[i % 3] = Math.max(high[i % 3], place[i]);
}
for (const { node, height, attachment } of run.buoys) for (let k = 0; k < run.frames; k++) {
  const z = place[3 * (k * nodes + node) + 2] - attachment;
  low[2] = Math.min(low[2], z); high[2] = Math.max(high[2], z + height);
}
if (bodies) for (let k = 0; k < run.frames; k++) for (const shape of bodies.shapes) for (const ring of shape.rings) for (const r of turned(ring, shape.body, [k, k, 0])) {
  for (let i = 0; i < 3; i++) { low[i] = Math.min(low[i], r[i]); high[i] = Math.max(high[i], r[i]); }
}
if (water) for (const rise of water.elevation) high[2] = Math.max(high[2], rise);
const middle = low.map((v, i) => (v + high[i]) / 2);
const size = Math.max(...high.map((v, i) => v - low[i]), 1e-9);
const TRAIL = 0.15;  // of the run
const DISTANCE = 2.6, LENS = 1.9;  // in sizes: how far the eye is, and how long its lens
const VIEWS = { free: [-0.65, 0.28], front: [0, 0], side: [-Math.PI / 2, 0], top: [0, Math.PI / 2] };
const eye = { turn: VIEWS.free[0], rise: VIEWS.free[1], zoom: 1, shift: [0, 0], even: false };  // even: without perspective
const state = { now: start, playing: false, last: 0, mouse: null, fingers: new Map(), taken: [] };

