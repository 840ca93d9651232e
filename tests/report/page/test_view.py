"""The interactive page: whole in one file, the run's numbers inside, and in a browser (where there is one) it works."""

import base64
import dataclasses
import itertools
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.report.page import view_page

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

#: Uses the page as a person would, and leaves what it saw in the page.
EXERCISE = """
<script>
// headless browsers draw frames when they please; a timer keeps the page's clock
window.requestAnimationFrame = (act) => setTimeout(() => act(performance.now()), 16);
const seen = {}, shot = () => canvas.toDataURL(), box = document.body.dataset;
const bright = (d, i) => d[i + 3] && Math.max(d[i], d[i + 1], d[i + 2]) - Math.min(d[i], d[i + 1], d[i + 2]) > 60;
const pixels = () => { const d = pen.getImageData(0, 0, canvas.width, canvas.height).data; let n = 0;
  for (let i = 0; i < d.length; i += 4) if (bright(d, i)) n++;
  return n; };
const changes = (name, act) => { const before = shot(); act(); seen[name + "_changes"] = shot() !== before; };
const point = (type, x, y) => canvas.dispatchEvent(new PointerEvent(type, { clientX: x, clientY: y, bubbles: true }));
seen.coloured = pixels();
changes("scrub", () => { byId("scrub").value = (start + end) / 2; byId("scrub").dispatchEvent(new Event("input")); });
seen.scrubbed = box.time;
changes("orbit", () => { point("pointerdown", 300, 300);
  point("pointermove", 380, 320);
  point("pointerup", 380, 320); });
seen.turned = box.turn;
changes("zoom", () => canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -300, cancelable: true })));
changes("water", () => byId("water").click());
byId("speed").value = "2"; byId("play").click(); seen.playing = box.playing;
const wait = (left) => {
  if (left && Number(box.time) <= 1.05) { setTimeout(() => wait(left - 1), 50); return; }
  seen.played = box.time; byId("play").click(); seen.paused = box.playing;
  const out = document.createElement("pre"); out.id = "seen"; out.textContent = JSON.stringify(seen);
  document.body.append(out);
};
wait(60);
</script></body>
"""


@pytest.fixture(scope="module")
def run():
    return dj.simulate("double-pendulum-chaotic", duration=2.0, dt=0.02)


@pytest.fixture(scope="module")
def wet():
    sea = {"depth": 30.0, "waves": {"kind": "regular", "amplitude": 1.0, "period": 6.0}}
    table = {
        "name": "wet <line> & sea",
        "run": {"dt": 0.05, "duration": 2.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, -1.0]},
            {"name": "end", "kind": "free", "position": [4.0, 0.0, -1.0]},
        ],
        "line": [{"name": "l", "from": "top", "to": "end", "links": 2, "length": 2.0, "mass": 5.0, "diameter": 0.05}],
        "effects": {"weight": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.0}},
        "sea": sea,
        "start": {"kind": "angles", "zero": "down", "polar": [0.5, 0.5]},
    }
    return dj.simulate(table)


def data(page: str) -> dict:
    return json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_page_is_one_file_that_asks_for_nothing_else(run):
    page = view_page(run)
    assert not re.findall(r"""(?:src|href)\s*=|https?:|@import|url\(|fetch\(|XMLHttp|WebSocket""", page)
    assert "/*" not in re.sub(r"<style>.*?</style>|<script>.*?</script>", "", page, flags=re.S)


def test_page_holds_the_positions_and_tensions_of_the_run(run):
    found = data(view_page(run))
    assert (found["frames"], found["nodes"], found["held"]) == (len(run.t), 3, [0])
    np.testing.assert_array_equal(floats(found["positions"]), run.positions.astype("f4").ravel())
    np.testing.assert_array_equal(floats(found["tension"]), run.tension.astype("f4").ravel())
    np.testing.assert_array_equal(floats(found["time"]), run.t.astype("f4"))
    assert found["water"] is None


def test_surface_of_the_page_is_the_regular_wave(wet):
    found = data(view_page(wet))["water"]
    steps = np.frombuffer(base64.b64decode(found["elevation"]), "<i2")
    eta = found["step"] * steps.reshape(found["frames"], found["points"], found["points"])
    x, t = np.array(found["x"]), floats(found["time"])
    k = 4 * np.pi**2 / 6.0**2 / 9.81  # deep water to 1 % at this depth
    phase = k * x[None, :] - 2 * np.pi / 6.0 * t[:, None]
    assert np.abs(eta[:, :, 0] - np.cos(phase)).max() < 0.05
    assert found["depth"] == 30.0


def test_arrows_of_waves_and_current_have_their_direction_and_size(wet):
    assert data(view_page(wet))["flows"] == [
        {"text": "waves, amplitude 1 m, T 6 s", "direction": 0.0, "colour": "#0072b2"}
    ]


def test_a_name_cannot_break_out_of_the_page(wet):
    page = view_page(wet)
    assert "<line>" not in page
    assert "<title>wet &lt;line&gt; &amp; sea</title>" in page
    assert data(page)["name"] == "wet <line> & sea"


def test_long_runs_are_thinned_and_keep_their_ends(run, monkeypatch):
    monkeypatch.setattr("dropper_jax.report.page_data.MAX_FRAMES", 10)
    found = data(view_page(run))
    assert found["frames"] == 10
    assert floats(found["time"])[[0, -1]].tolist() == [0.0, 2.0]


def test_command_writes_the_page_and_refuses_other_files(run, tmp_path, printed, json_of):
    saved, page = run.save(tmp_path / "run.npz"), tmp_path / "view.html"
    assert json_of(["view", str(saved), "--out", str(page), "--json"])["bytes"] == page.stat().st_size
    assert "--out" in printed(["view", str(saved), "--out", str(tmp_path / "view.txt")], 2).err
    (tmp_path / "bad.npz").write_text("nothing")
    assert "not a saved run" in printed(["view", str(tmp_path / "bad.npz"), "--out", str(page)], 2).err


def seen_with(script, page, folder):
    """What a script at the page's end has written into its element `seen`."""
    shown = folder / "page.html"
    shown.write_text(page.replace("</body>", script), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=5000", "--window-size=900,600"]
    command = [BROWSER, *options, f"--user-data-dir={folder}/profile", "--dump-dom", shown.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-500:]
    return json.loads(found[1])


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the page's structure is checked, its working is not")
def test_page_plays_scrubs_and_turns_in_a_browser(wet, tmp_path):
    seen = seen_with(EXERCISE, view_page(wet), tmp_path)
    assert seen["coloured"] > 300  # links drawn in the colours of their tensions
    assert float(seen["scrubbed"]) == pytest.approx(1.0, abs=1e-3)
    assert float(seen["turned"]) == pytest.approx(-0.65 - 0.008 * 80, abs=2e-3)
    assert all(seen[f"{name}_changes"] for name in ("scrub", "orbit", "zoom", "water"))
    assert seen["playing"] == "true"
    assert seen["paused"] == "false"
    assert float(seen["played"]) > 1.05


#: Boxes [px] of what is read or pressed, of the texts in the picture by view, and heights, before and after "more".
BOXES = """(() => {
  const box = (one) => { const r = one.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; };
  const all = (list) => [...document.querySelectorAll(list)].filter((one) => one.checkVisibility()).map(box);
  const parts = "#name, #how, #about summary, #unit, #bar, #high, #mid, #low, "
    + "footer button, footer input, footer select";
  const footer = () => document.querySelector("footer").clientHeight / innerHeight;
  const found = { page: [innerWidth, innerHeight], closed: footer(), before: all(parts), texts: {} };
  for (const view of ["free", "front", "side", "top"]) {
    look(view); found.texts[view] = state.taken.map((b) => b.map((v) => v / ratio())); }
  if (byId("more").checkVisibility()) byId("more").click();
  found.opened = footer(); found.after = all(parts);
  return found; })()"""


def overlapping(boxes):
    """Pairs of boxes (left, top, right, bottom) of which one is over the other by more than a pixel."""
    found = []
    for one, other in itertools.combinations(boxes, 2):
        across = min(one[2], other[2]) - max(one[0], other[0])
        down = min(one[3], other[3]) - max(one[1], other[1])
        if min(across, down) > 1.0:
            found.append((one, other))
    return found


@pytest.mark.parametrize("width", [360, 390, 900])
def test_nothing_overlaps_and_controls_are_small_on_a_phone_in_a_browser(longline, in_browser, width):
    solution = longline()
    named = dataclasses.replace(solution.scene, name="a-longline-with-a-name-of-some-length")
    seen = in_browser(view_page(dataclasses.replace(solution, scene=named)), BOXES, width=width)
    assert seen["page"][0] == width
    assert seen["closed"] < 0.1
    assert seen["opened"] < 0.25
    assert len(seen["after"]) >= 8 + 15
    for boxes in (seen["before"], seen["after"], *seen["texts"].values()):
        assert overlapping(boxes) == []
        assert min(min(box[:2]) for box in boxes) >= 0
        assert max(box[2] for box in boxes) <= width
        assert max(box[3] for box in boxes) <= seen["page"][1]
    assert all(len(texts) > 2 for texts in seen["texts"].values())


def test_page_of_a_system_has_links_within_lines_buoys_bed_and_names(longline):
    solution = longline()
    found = data(view_page(solution))
    assert found["first"] == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11, 12, 14, 15, 16, 17, 18, 19]
    assert found["labels"][4] == "backbone 1"
    name, s, number = found["parts"][5].split(", ")
    assert (name, number) == ("backbone", "segment 2")
    first, last = (np.linalg.norm(np.diff(solution.positions[0, 5:8], axis=0), axis=1) * [1.0, 0.5]).tolist()
    assert float(s.removesuffix(" m")) == pytest.approx(first + last, abs=0.051)
    assert found["held"] == [0, 13]
    assert [buoy["node"] for buoy in found["buoys"]] == [4, 8]
    assert set(found["bed"]["z"]) == {-20.0}
    np.testing.assert_allclose(np.diff(found["bed"]["x"]), 10.0)
    assert floats(found["tension"]).size == solution.tension.size


@pytest.mark.skipif(BROWSER is None, reason="no browser here")
def test_page_of_a_system_draws_its_lines_and_buoys_in_a_browser(longline, tmp_path):
    probe = """<script>{
    const orange = () => { const d = pen.getImageData(0, 0, canvas.width, canvas.height).data; let n = 0;
      for (let i = 0; i < d.length; i += 4) if (d[i] > 200 && d[i + 1] > 130 && d[i + 1] < 200 && d[i + 2] < 70) n++;
      return n; };
    const out = document.createElement("pre"), ready = document.body.dataset.ready, before = orange();
    run.buoys.length = 0; draw();  // what is left has the colours of the tensions
    const seen = { buoys: before - orange(), links: line(locate(time, 1.0)).pull.length, at: elevation(0, 0), ready };
    out.id = "seen"; out.textContent = JSON.stringify(seen); document.body.append(out);
    }</script></body>"""
    seen = seen_with(probe, view_page(longline()), tmp_path)
    assert seen["ready"] == "1"
    assert seen["links"] == 17
    assert seen["buoys"] > 15
    assert abs(seen["at"]) <= 0.8 + 1e-6
