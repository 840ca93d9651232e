// One of two runs side by side: what is done to one view is told to the other, also where that one comes later.
const pair = { seen: null, acted: false, quiet: false };
function seen_here() {
  return { now: state.now, playing: state.playing, speed: byId("speed").value, turn: eye.turn, rise: eye.rise, zoom: eye.zoom, shift: eye.shift, even: eye.even, options: opened(), checks: ["trail", "water", "names"].map((id) => byId(id).checked) };
}
function send(what) { window.parent.postMessage({ ...what, of: window.name }, "*"); }
function tell_other() {
  if (window.parent === window || pair.quiet) return;
  const before = pair.seen;
  pair.seen = JSON.stringify(seen_here());
  if (before === null) send({ asks: true });  // the first picture is nobody's act
  else if (before !== pair.seen) { pair.acted = true; send({ dropper: seen_here() }); }
}
addEventListener("message", ({ data }) => {
  if (!data || data.of === window.name || window.parent === window) return;
  if (data.asks && pair.acted) send({ dropper: seen_here() });
  const link = run.labels.indexOf(data.wants);
  if (link >= 0) send({ curve: data.wants, time, tension: tension_of(link) });
  if (data.curve && picked.link !== null && data.curve === run.labels[picked.link]) compare(data);
  if (!data.dropper) return;
  const { now, playing, speed, options, checks, ...view } = data.dropper;
  pair.quiet = true;
  if (options !== opened()) open_options(options);
  Object.assign(eye, view); byId("speed").value = speed;
  ["trail", "water", "names"].forEach((id, i) => { byId(id).checked = checks[i]; });
  state.now = Math.min(end, Math.max(start, now));
  if (state.playing) play(false);  // the clock that runs is the other one's
  draw();
  pair.quiet = false;
  pair.seen = JSON.stringify(seen_here());
});
