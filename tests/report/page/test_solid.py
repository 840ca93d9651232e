"""Which frames a page shows; and in a browser: ropes as solids, a click on a part, two runs side by side."""

import html
import json
import re

import numpy as np
import pytest

from dropper_jax.plots.run import readable
from dropper_jax.report.page import pair_page, view_page
from dropper_jax.report.page_samples import IN_A_WAVE, choose_samples, wave_period

#: With WebGL in software, and without any.
WITH = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WITHOUT = ("--disable-gpu", "--disable-3d-apis")


@pytest.fixture(scope="module")
def solution(longline):
    return longline()


@pytest.fixture(scope="module")
def page(solution):
    return view_page(solution)


def test_waves_are_met_by_enough_frames_and_a_long_run_is_shown_in_part(longline):
    solution = longline(samples=601)  # 60 s of waves of 6 s
    run = readable(solution)
    assert wave_period(run) == pytest.approx(6.0, rel=0.01)
    whole = choose_samples(run, 3000)
    assert (whole.frames[0], whole.frames[-1], whole.notes) == (0, 600, ())
    part = choose_samples(run, 40)
    assert np.diff(run.t[part.frames]).max() <= 1.4 * 6.0 / IN_A_WAVE  # whole samples of 0.1 s
    assert np.diff(part.surface).max() <= 6.0 / IN_A_WAVE
    assert run.t[part.frames[0]] <= run.t[np.argmax(run.max_tension.max(axis=1))] <= run.t[part.frames[-1]]
    assert "of 60 s, around the maximum tension" in part.notes[0]


def test_frames_saved_too_far_apart_for_the_waves_are_reported(longline):
    solution = longline(samples=601)
    for name in ("t", "positions", "velocities", "tension", "t_tension", "kinetic", "potential", "work", "step_status"):
        setattr(solution, name, getattr(solution, name)[::40])
    reported = choose_samples(readable(solution), 3000).notes
    assert "saved every 4 s in waves of 6" in reported[0]


@pytest.mark.check
@pytest.mark.parametrize("options", [WITH, WITHOUT], ids=["webgl", "canvas"])
def test_a_click_on_a_rope_shows_its_tension_and_a_trail(page, in_browser, options):
    probe = """(() => {
      const j = 5, a = state.points[run.first[j]], b = state.points[run.first[j] + 1];
      const edge = canvas.getBoundingClientRect(), at = { clientX: edge.left + (a[0] + b[0]) / 2 / ratio(),
        clientY: edge.top + (a[1] + b[1]) / 2 / ratio(), bubbles: true };
      for (const act of ["pointerdown", "pointerup"]) canvas.dispatchEvent(new PointerEvent(act, at));
      const count = (sheet, what) => { let n = 0;
        const d = sheet.getContext("2d").getImageData(0, 0, sheet.width, sheet.height).data;
        for (let i = 0; i < d.length; i += 4) if (d[i + 3] && what(d[i], d[i + 1], d[i + 2])) n++;
        return n; };
      return { solid: solids !== null, picked: document.body.dataset.picked, hidden: byId("part").hidden,
        range: byId("part-range").textContent, node: picked.node,
        blue: count(byId("trace"), (r, g, b) => r < 40 && g > 90 && b > 150),
        vivid: count(canvas, (r, g, b) => Math.max(r, g, b) - Math.min(r, g, b) > 90),
        kept: (() => { let kept; window.save = (name, blob) => { kept = [name, blob.type, blob.size]; };
          save_curve(); return kept; })(),
        long: [force(12345), force(57.54), plain(0.00123), clock(3.5)] };
    })()"""
    seen = in_browser(page, probe, options)
    assert seen["solid"] == (options == WITH)
    assert seen["picked"] == "backbone 2"
    assert seen["node"] in (6, 7)
    name, kind, size = seen["kept"]
    assert name.endswith(".csv")
    assert kind == "text/csv"
    assert size > 200
    # 1000 N (1 + 0.3 sin + 0.1 5/17): from 729.4 N to 1329.4 N
    assert seen["range"] == "729 N to 1.33 kN, mean 1.03 kN"
    assert not seen["hidden"]
    assert seen["blue"] > 200
    assert seen["vivid"] > 500
    assert seen["long"] == ["12.3 kN", "57.5 N", "0.00123", "3.50"]


def test_a_solid_rope_is_as_bright_as_its_tension_through_the_water(page, in_browser):
    """Colours between 0.7 of the scale's and the scale's own: nothing washes them out."""
    probe = """(() => {
      byId("names").checked = false; byId("trail").checked = false; eye.zoom = 2; draw();
      const j = 5, a = state.points[run.first[j]], b = state.points[run.first[j] + 1];
      const p = pen.getImageData(Math.round((a[0] + b[0]) / 2), Math.round((a[1] + b[1]) / 2), 1, 1).data;
      const want = colour(sample(tension, links, locate(time, state.now))[j]).match(/\\d+/g).map(Number);
      return { got: [...p].slice(0, 3), want };
    })()"""
    seen = in_browser(page, probe, WITH)
    share = np.array(seen["got"]) / np.maximum(seen["want"], 1)
    strong = np.array(seen["want"]) > 60
    assert np.all((share[strong] > 0.65) & (share[strong] < 1.05))
    assert np.ptp(share[strong]) < 0.1


@pytest.mark.parametrize("options", [WITH, WITHOUT], ids=["webgl", "canvas"])
def test_a_view_fits_the_lines_is_to_scale_from_the_side_and_pinches(page, in_browser, options):
    probe = """(() => {
      const extent = (i) => { const all = state.points.map((p) => p[i]); return [Math.min(...all), Math.max(...all)]; };
      const fitted = [extent(0), extent(1)], size = [canvas.width, canvas.height];
      document.querySelector("[data-view=front]").click();
      const metre = (a, b) => {
        const [p, q] = [project(...a), project(...b)]; return Math.hypot(p[0] - q[0], p[1] - q[1]); };
      const scales = [metre([0, 0, 0], [1, 0, 0]), metre([0, 9, -5], [1, 9, -5]), metre([5, -9, 0], [5, -9, 1])];
      const before = eye.zoom, finger = (kind, id, x) => canvas.dispatchEvent(
        new PointerEvent(kind, { pointerId: id, clientX: x, clientY: 200, bubbles: true }));
      finger("pointerdown", 1, 200); finger("pointerdown", 2, 300); finger("pointermove", 2, 400);
      finger("pointerup", 1, 200); finger("pointerup", 2, 400);
      return { fitted, size, scales, pinched: eye.zoom / before, part: run.parts[5] };
    })()"""
    seen = in_browser(page, probe, options)
    for (low, high), size in zip(seen["fitted"], seen["size"], strict=True):
        assert 0 < low < high < size
    assert max((high - low) / size for (low, high), size in zip(seen["fitted"], seen["size"], strict=True)) > 0.6
    assert np.ptp(seen["scales"]) < 1e-6 * seen["scales"][0]
    assert seen["pinched"] == pytest.approx(2.0)
    assert seen["part"].startswith("backbone, ")


def test_a_ruler_shows_the_distance_of_two_nodes_and_a_link_gives_the_view_again(page, solution, in_browser):
    probe = """(() => {
      const view = (name) => document.querySelector(`[data-view=${name}]`).click();
      byId("ruler").checked = true; state.now = 1; view("front");
      const edge = canvas.getBoundingClientRect();
      for (const node of [2, 10]) for (const act of ["pointerdown", "pointerup"]) {
        const [x, y] = state.points[node].map((v) => v / ratio());
        canvas.dispatchEvent(new PointerEvent(act, { clientX: edge.left + x, clientY: edge.top + y, bubbles: true })); }
      const nodes = [...picked.ends], distance = document.body.dataset.ruler, untouched = picked.link;
      view("free"); Object.assign(eye, { turn: 0.3, zoom: 2, shift: [30, -20] }); state.now = 2.5;
      pick({ link: 5, node: 6 }); share();
      view("top"); state.now = 0; pick(null); follow();
      return { nodes, distance, untouched, hash: location.hash, eye, now: state.now, picked: picked.link };
    })()"""
    seen = in_browser(page, probe, WITHOUT)
    one, other = solution.positions[10][seen["nodes"]]
    size, *parts = map(float, re.findall(r"-?[\d.]+", seen["distance"]))
    assert size == pytest.approx(np.linalg.norm(other - one), rel=1e-3)
    np.testing.assert_allclose(parts, other - one, atol=0.0051)
    assert seen["untouched"] is None
    assert "part=backbone+2" in seen["hash"]
    assert (seen["now"], seen["picked"], seen["eye"]["even"]) == (2.5, 5, False)
    assert (seen["eye"]["turn"], seen["eye"]["zoom"]) == (0.3, 2)
    np.testing.assert_allclose(seen["eye"]["shift"], [30, -20], atol=0.1)


@pytest.mark.check
def test_two_runs_side_by_side_share_clock_camera_and_colours(solution, longline, in_browser):
    other = longline(0.0)
    other.tension[:] *= 3.0
    both = pair_page(solution, other)
    ranges = [json.loads(m)["range"] for m in re.findall(r'json">(.*?)</script>', html.unescape(both), re.S)]
    assert ranges[0] == ranges[1]
    probe = """(() => { const [a, b] = [...document.querySelectorAll("iframe")].map((f) => f.contentWindow);
      const both = (key) => [a, b].map((w) => w.document.body.dataset[key]);
      const shown = [a, b].map((w) => w.getComputedStyle(w.document.querySelector("footer")).visibility);
      const other = a.document.getElementById("part-other").textContent;
      return { clocks: both("time"), turns: both("turn"), shown, other }; })()"""
    act = """<script>const waiting = setInterval(() => {
      const views = [...document.querySelectorAll("iframe")].map((f) => f.contentWindow);
      if (!views.every((w) => w.document.body && w.document.body.dataset.ready)) return;
      clearInterval(waiting); views[0].eval("eye.turn = 0.5; state.now = 2.5; pick({ link: 5, node: 6 })"); /* late */
      }, 100);</script></body>"""
    both_moved = {"clocks": ["2.5000", "2.5000"], "turns": ["0.500", "0.500"], "shown": ["visible", "hidden"]}
    # three times 1000 N (1 + 0.3 sin + 0.1 5/17), which is between 729.4 and 1329.4 N
    both_moved["other"] = "other run 2.19 kN to 3.99 kN, up to 2.66 kN apart"
    assert in_browser(both.replace("</body>", act), probe, WITH, 30000, 200) == both_moved
    # a view that comes later is shown what was done, and its own beginning moves nothing
    again = """setTimeout(() => {
      const second = document.querySelectorAll("iframe")[1]; second.srcdoc = second.srcdoc; }, 500);"""
    late = act.replace("/* late */", again)
    assert in_browser(both.replace("</body>", late), probe, WITH, 30000, 200) == both_moved


def test_a_description_with_the_page_s_own_marks_changes_nothing(solution):
    import dataclasses

    scene = dataclasses.replace(solution.scene, description="/*SCRIPT*/ /*DATA*/ </script>")
    page = view_page(dataclasses.replace(solution, scene=scene))
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])
    assert data["description"] == "/*SCRIPT*/ /*DATA*/ </script>"
    assert page.count("function locate(") == 1
