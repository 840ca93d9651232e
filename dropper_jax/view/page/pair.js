// One of two runs side by side: what is done to one view is told to the other.
const pair = { other: null, quiet: false };
function tell_other() {
  if (window.parent === window || pair.quiet) return;
  const seen = { now: state.now, playing: state.playing, speed: byId("speed").value, turn: eye.turn, rise: eye.rise, zoom: eye.zoom, shift: eye.shift };
  window.parent.postMessage({ dropper: seen, of: window.name }, "*");
}
addEventListener("message", ({ data }) => {
  if (!data || !data.dropper || data.of === window.name || window.parent === window) return;
  const { now, playing, speed, ...view } = data.dropper;
  pair.quiet = true;
  Object.assign(eye, view); byId("speed").value = speed;
  state.now = Math.min(end, Math.max(start, now));
  if (state.playing) play(false);  // the clock that runs is the other one's
  draw();
  pair.quiet = false;
});
