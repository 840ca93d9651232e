// Ropes, buoys, bed and water as solids with depth and light, by WebGL into a canvas of its own, which `draw` lays
// under names and marks. `solids` is null where WebGL is missing: then view.js draws lines and polygons instead.
const SIDES = 8, LEAST = 2.2;  // of a rope: sides of its tube, least radius [pixel]
const solids = (() => {
  const sheet = document.createElement("canvas");
  const gl = sheet.getContext("webgl", { antialias: true, alpha: true, premultipliedAlpha: true, preserveDrawingBuffer: true });
  if (!gl) return null;
  const vertex = `attribute vec3 place, normal; attribute vec4 tint; uniform vec4 turn; uniform vec4 lens; uniform float even;
    varying vec3 way; varying vec4 shade;
    void main() {
      float right = turn.x * place.x + turn.y * place.y, away = turn.x * place.y - turn.y * place.x;
      float deep = turn.z * away - turn.w * place.z, up = turn.w * away + turn.z * place.z;
      float w = max(${DISTANCE.toFixed(3)} + (1.0 - even) * deep, 0.001);
      gl_Position = vec4(right * lens.x + lens.z * w, up * lens.y + lens.w * w, mix(1.002 * w - 0.1, 0.3 * deep * w, even), w);
      way = vec3(turn.x * normal.x + turn.y * normal.y, turn.w * (turn.x * normal.y - turn.y * normal.x) + turn.z * normal.z,
        turn.w * normal.z - turn.z * (turn.x * normal.y - turn.y * normal.x));
      shade = tint;
    }`;
  // light from the upper left behind the eye; a floor of 0.7 keeps the colours of the tension what they are
  const fragment = `precision mediump float; varying vec3 way; varying vec4 shade;
    void main() {
      vec3 n = normalize(way); float lit = 0.7 + 0.3 * max(0.0, dot(n.z < 0.0 ? -n : n, vec3(-0.42, 0.62, 0.66)));
      gl_FragColor = vec4(shade.rgb * lit * shade.a, shade.a);
    }`;
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  ["place", "normal", "tint"].forEach((name, i) => {
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, i < 2 ? 3 : 4, gl.FLOAT, false, 40, 12 * i);
  });
  const where = (name) => gl.getUniformLocation(program, name), turnAt = where("turn"), lensAt = where("lens"), evenAt = where("even");
  gl.enable(gl.DEPTH_TEST);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

  let held = new Float32Array(1 << 16), used = 0;  // triangles: place, normal, colour of each corner
  function corner(x, y, z, nx, ny, nz, [r, g, b, a]) {
    if (used + 10 > held.length) { const more = new Float32Array(2 * held.length); more.set(held); held = more; }
    held.set([(x - middle[0]) / size, (y - middle[1]) / size, (z - middle[2]) / size, nx, ny, nz, r, g, b, a], used);
    used += 10;
  }
  function flush(kind = gl.TRIANGLES) { gl.bufferData(gl.ARRAY_BUFFER, held.subarray(0, used), gl.DYNAMIC_DRAW); gl.drawArrays(kind, 0, used / 10); used = 0; }
  function tube(a, b, first, last, tint) {  // between places a and b, radii first and last [m]
    const d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], long = Math.hypot(...d) || 1;
    const t = d.map((v) => v / long), k = Math.abs(t[2]) < 0.9 ? [-t[1], t[0], 0] : [0, -t[2], t[1]];
    const h = Math.hypot(...k), u = k.map((v) => v / h);
    const v = [t[1] * u[2] - t[2] * u[1], t[2] * u[0] - t[0] * u[2], t[0] * u[1] - t[1] * u[0]];
    const out = (i) => { const c = Math.cos(2 * Math.PI * i / SIDES), s = Math.sin(2 * Math.PI * i / SIDES); return [0, 1, 2].map((m) => c * u[m] + s * v[m]); };
    for (let i = 0; i < SIDES; i++) {
      const [n, m] = [out(i), out(i + 1)], at = (p, r, q) => corner(p[0] + r * q[0], p[1] + r * q[1], p[2] + r * q[2], ...q, tint);
      at(a, first, n); at(a, first, m); at(b, last, n); at(b, last, n); at(a, first, m); at(b, last, m);
    }
  }
  function ball(c, radius, tint) {  // an octahedron, once refined: fills the bend between two tubes
    const dirs = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], unit = (p) => { const l = Math.hypot(...p); return p.map((v) => v / l); };
    const put = (...three) => three.forEach((q) => corner(c[0] + radius * q[0], c[1] + radius * q[1], c[2] + radius * q[2], ...q, tint));
    for (let i = 0; i < 4; i++) for (const tip of [[0, 0, 1], [0, 0, -1]]) {
      const [a, b] = [dirs[i], dirs[(i + 1) % 4]], [ab, bt, ta] = [[a, b], [b, tip], [tip, a]].map(([p, q]) => unit(p.map((v, m) => v + q[m])));
      put(a, ab, ta); put(ab, b, bt); put(ta, bt, tip); put(ab, bt, ta);
    }
  }
  function cylinder([x, y, z], half, top, tint) {
    for (let i = 0; i < 24; i++) {
      const [a, b] = [i, i + 1].map((k) => [Math.cos(Math.PI * k / 12), Math.sin(Math.PI * k / 12)]);
      const at = ([c, s], h, n = [c, s, 0]) => corner(x + half * c, y + half * s, h, ...n, tint);
      at(a, z); at(b, z); at(a, top); at(a, top); at(b, z); at(b, top);
      for (const [h, n] of [[top, [0, 0, 1]], [z, [0, 0, -1]]]) { at(a, h, n); at(b, h, n); corner(x, y, h, ...n, tint); }
    }
  }
  function hulls(rings, tint) {  // between circles one after another, closed at both ends
    const mean = (list) => [0, 1, 2].map((m) => list.reduce((sum, p) => sum + p[m], 0) / list.length);
    const centres = rings.map(mean), whole = mean(centres), unit = (p) => { const l = Math.hypot(...p) || 1; return p.map((v) => v / l); };
    const at = (k, i) => { const p = rings[k][i % rings[k].length]; corner(...p, ...unit(p.map((v, m) => v - centres[k][m])), tint); };
    for (let k = 0; k + 1 < rings.length; k++) for (let i = 0; i < rings[k].length; i++) {
      at(k, i); at(k, i + 1); at(k + 1, i); at(k + 1, i); at(k, i + 1); at(k + 1, i + 1);
    }
    for (const k of [0, rings.length - 1]) {
      const n = unit(centres[k].map((v, m) => v - whole[m])), ring = rings[k];
      ring.forEach((p, i) => { corner(...p, ...n, tint); corner(...ring[(i + 1) % ring.length], ...n, tint); corner(...centres[k], ...n, tint); });
    }
  }
  function mesh(n, x, y, height, tint) {
    const slope = (i, j) => {
      const [a, b] = [Math.max(i - 1, 0), Math.min(i + 1, n - 1)], [c, d] = [Math.max(j - 1, 0), Math.min(j + 1, n - 1)];
      const p = [-(height(b, j) - height(a, j)) / (x[b] - x[a]), -(height(i, d) - height(i, c)) / (y[d] - y[c]), 1], l = Math.hypot(...p);
      return p.map((v) => v / l);
    };
    const at = (i, j) => corner(x[i], y[j], height(i, j), ...slope(i, j), tint);
    for (let i = 0; i + 1 < n; i++) for (let j = 0; j + 1 < n; j++) {
      at(i, j); at(i + 1, j); at(i, j + 1); at(i, j + 1); at(i + 1, j); at(i + 1, j + 1);
    }
  }
  function net(n, x, y, height, tint) {  // its lines, a little above
    const at = (i, j) => corner(x[i], y[j], height(i, j) + 0.001 * size, 0, 0, 1, tint);
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
      if (i + 1 < n) { at(i, j); at(i + 1, j); }
      if (j + 1 < n) { at(i, j); at(i, j + 1); }
    }
  }
  const share = (text) => [...text.match(/\d+/g).slice(0, 3).map((v) => v / 255), 1];
  function render(r, pull, frame, wet) {
    const [w, h] = [canvas.width, canvas.height], m = 2 * Math.min(w, h) * LENS * eye.zoom;
    if (sheet.width !== w || sheet.height !== h) { sheet.width = w; sheet.height = h; }
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); gl.disable(gl.BLEND);
    gl.uniform4f(turnAt, Math.cos(eye.turn), Math.sin(eye.turn), Math.cos(eye.rise), Math.sin(eye.rise));
    gl.uniform4f(lensAt, m / w, m / h, 2 * eye.shift[0] / w, -2 * eye.shift[1] / h);
    gl.uniform1f(evenAt, eye.even ? 1 : 0);
    if (run.bed) {
      const ground = [run.bed.points, run.bed.x, run.bed.y, (i, j) => run.bed.z[i * run.bed.points + j]];
      mesh(...ground, [0.9, 0.86, 0.78, 1]); flush();
      net(...ground, [0.78, 0.72, 0.62, 1]); flush(gl.LINES);
    }
    for (const { node, diameter, height, attachment } of run.buoys) {
      const foot = r[3 * node + 2] - attachment;
      cylinder([r[3 * node], r[3 * node + 1], foot], diameter / 2, foot + height, [0.98, 0.68, 0, 1]);
    }
    if (typeof bodies !== "undefined" && bodies) {
      for (const { body, rings } of bodies.shapes) hulls(rings.map((ring) => turned(ring, body, frame)), [0.98, 0.68, 0, 1]);
    }
    flush();
    if (wet) {  // after what stands in it, before the ropes: their colours are read, so nothing may lie over them
      gl.enable(gl.BLEND); gl.depthMask(false);
      const n = water.points, eta = sample(water.elevation, n * n, locate(water.time, state.now));
      const sea = [n, water.x, water.y, (i, j) => eta[i * n + j]];
      mesh(...sea, [0.25, 0.62, 0.85, 0.3]); flush();
      net(...sea, [0.1, 0.42, 0.65, 0.22]); flush(gl.LINES);
      gl.disable(gl.BLEND); gl.depthMask(true);
    }
    const point = (i) => [r[3 * i], r[3 * i + 1], r[3 * i + 2]];
    const pixel = (p) => size * (eye.even ? DISTANCE : Math.max(DISTANCE + project(...p)[2], 0.05)) / (m / 2);  // size of a pixel there [m]
    for (let j = 0; j < links; j++) {
      const [a, b] = [point(run.first[j]), point(run.first[j] + 1)], tint = share(colour(pull[j]));
      const own = run.diameter ? run.diameter[j] / 2 : 0, bold = picked.link === j ? 2 : 1;
      const [p, q] = [a, b].map((one) => bold * Math.max(own, (nodes > 300 ? 0.7 : 1) * LEAST * ratio() * pixel(one)));
      tube(a, b, p, q, tint); ball(a, p, tint); ball(b, q, tint);
    }
    flush();
    return sheet;
  }
  return { render };
})();
