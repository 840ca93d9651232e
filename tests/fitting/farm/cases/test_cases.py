"""Load cases: runs against plain simulations, resumption, utilisation by hand, and the command."""

import copy
import csv
import json
import math
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.effects import EFFECTS, register_file
from dropper_jax.evaluation.record import record
from dropper_jax.evaluation.tension import anchors
from dropper_jax.scene import line_slices
from fitting.farm.cases import assess, run_cases, write_page
from fitting.farm.cases.case_run import CaseRunner
from fitting.farm.cases.case_store import CaseStore as Store
from fitting.farm.cases.characteristic import characteristic_load
from fitting.farm.cases.page import page_text
from fitting.farm.cases.run_arrays import QuantityValues
from fitting.farm.cases.step_errors import step_errors
from fitting.farm.site import Case, read_site
from fitting.farm.site.sections import RunValues
from fitting.farm.site.standards import standards

DT = 0.02
#: A buoy on two legs.
SCENE = {
    "name": "mooring",
    "run": {"dt": 0.02, "duration": 1.0},
    "line_type": [
        {"name": "rope", "mass": 1.2, "diameter": 0.03, "EA": 5e4, "damping_ratio": 0.3, "cdn": 1.2, "cdt": 0.02},
    ],
    "point": [
        {"name": "west-anchor", "position": [-8.0, 0.0, -10.0]},
        {"name": "east-anchor", "position": [8.0, 0.0, -10.0]},
        {"name": "buoy", "kind": "free", "position": [0.0, 0.0, -4.0], "mass": 20.0, "volume": 0.2, "drag_area": 0.2},
    ],
    "line": [
        {"name": "west-leg", "from": "west-anchor", "to": "buoy", "type": "rope", "length": 10.0, "links": 2},
        {"name": "east-leg", "from": "east-anchor", "to": "buoy", "type": "rope", "length": 10.0, "links": 2},
    ],
    "sea": {"depth": 10.0},
    "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
}
SITE = {
    "name": "small bay",
    "scene": SCENE,
    "run": {"duration": 12.0, "skip": 4.0, "seeds": 3, "ramp": 2.0, "step_seeds": 2},
    "sea_state": [{"name": "storm", "hs": 1.0, "tp": 5.0, "count": 12, "hours": 100.0}],
    "cases": {"directions": [0.0], "currents": [0.0, 0.5], "states": ["intact", "west-leg"], "break_time": 8.0},
    "factors": {"intact": 1.5, "broken": 1.2, "source": "example, check against your standard", "edition": "none"},
    "part": [{"name": "legs", "lines": "*-leg", "capacity": 8e3, "curve": {"k": 1e3, "m": 3.0, "source": "example"}}],
    "anchor": [
        {"points": "west-*", "kind": "dead_weight", "weight": 9e3, "friction": 0.5, "uplift": 80.0},
        {"points": "east-*", "capacity": 6e3},
    ],
    "quantities": ["tension.east-leg.anchor.max", "anchor.east-anchor.horizontal.max", "z.buoy.mean"],
    "exclusion": {"excursion": 4.0},
    "backbone": {"lines": "west-leg", "shallowest": 0.5, "deepest": 12.0},
}


def small_site(**sections):
    """The site with sections in the place of its own."""
    return read_site({**copy.deepcopy(SITE), **sections})


@pytest.fixture(scope="module")
def site():
    return small_site()


@pytest.fixture(scope="module")
def folder(site, tmp_path_factory):
    """The runs of the small site, stopped in the middle once."""
    out = tmp_path_factory.mktemp("cases")

    def stop(share, text):
        if share >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cases(site, out, progress=stop)
    done = run_cases(site, out)
    assert (done.runs, done.resumed) == (12, 6)
    return out


@pytest.fixture(scope="module")
def found(site, folder):
    first = assess(site, folder)
    return assess(site, folder, step_errors(site, folder, first))


@pytest.mark.check
def test_steps_of_cases_follow_the_accuracy_of_the_site(tmp_path):
    """The loads of runs in fine equal steps, and an error by the step from runs at a quarter of the accuracy."""
    cases = {"directions": [0.0], "currents": [0.5]}
    run = {**SITE["run"], "seeds": 1, "step_seeds": 1}
    loads = {}
    for key, value in (("accuracy", 0.01), ("dt", 0.002)):
        site = small_site(cases=cases, run={**run, key: value})
        run_cases(site, tmp_path)
        found = assess(site, tmp_path)
        loads[key] = found["parts"][0]["worst"]["load_n"]
        assert (found["dt_s"], found["accuracy"]) == (site.run.dt, site.run.accuracy)
    assert loads["accuracy"] == pytest.approx(loads["dt"], rel=0.02)
    site = small_site(cases=cases, run={**run, "accuracy": 0.01})
    error = step_errors(site, tmp_path, assess(site, tmp_path))["legs"]
    assert list(error["by_step"]) == ["0.01", "0.0025"]
    assert error["relative"] < 0.02
    assert "accuracy 0.01" in page_text(assess(site, tmp_path))
    with pytest.raises(SceneError, match=r"run\.dt: 0\.01 excludes accuracy"):
        small_site(run={**run, "accuracy": 0.01, "dt": 0.01})


@pytest.mark.check
def test_breaks_of_the_scenes_own_failures_are_not_those_of_a_state():
    """The east leg breaks at once in every run; the west leg, that of the state, only where a run reaches its time."""
    scene = {**SCENE, "failure": [{"line": "east-leg", "link": 1, "time": 0.1}]}
    cases = {"directions": [0.0], "currents": [0.5], "states": ["intact", "west-leg"], "break_time": 0.8}
    site = small_site(scene=scene, cases=cases, run={**SITE["run"], "duration": 1.0, "skip": 0.4}, quantities=[])
    intact, broken = (next(case for case in site.cases if case.storm.state == name) for name in ("intact", "west-leg"))
    run = CaseRunner(site)
    assert run(intact)["broken"].tolist() == []
    np.testing.assert_allclose(run(broken)["broken"], [0.8])


@pytest.mark.check
def test_a_run_keeps_the_loads_of_a_plain_simulation_of_its_scene(site, folder):
    """The same scene by `simulate`, its extremes and held loads by the report of runs."""
    case = site.cases[-1]  # current, west leg broken
    kept = Store(folder, site).read(case)
    solution = dj.simulate(site.prepared().with_values(site.changes(case)))
    skip = site.run_of(case.storm).skip
    assert skip == site.break_time > site.run.skip
    late = solution.t > skip
    np.testing.assert_allclose(kept["largest"], solution.tension[late].max(axis=0), rtol=1e-9)
    np.testing.assert_allclose(kept["rest"], solution.tension[0], rtol=1e-9)
    assert kept["broken"].tolist() == [solution.broken[0]["time_s"]]
    west = next(row for row in anchors(record(solution, skip + 0.5 * DT)) if row["point"] == "west-anchor")
    horizontal, upward = kept["held_loads"][:, 0].T
    # places half a step apart from tensions, in the report and not here
    np.testing.assert_allclose(horizontal.max(), west["horizontal_n"]["max"], rtol=0.02)
    np.testing.assert_allclose(upward.max(), west["vertical_n"]["max"], rtol=0.02)
    east = {name.partition(":")[2]: float(kept[name]) for name in kept if name.startswith("quantity:")}
    first = line_slices(solution.scene)[1]
    np.testing.assert_allclose(
        east["tension.east-leg.anchor.max"], solution.tension[late, first.links.start].max(), rtol=0.01
    )
    assert east["anchor.east-anchor.horizontal.max"] < east["tension.east-leg.anchor.max"]
    buoy = solution.positions[late, first.nodes.stop - 1, 2]
    np.testing.assert_allclose(east["z.buoy.mean"], buoy.mean(), rtol=1e-9)


@pytest.mark.check
def test_quantities_by_name_are_in_the_report_and_wrong_ones_are_refused(found):
    rows = found["cases"][0]["quantities"]
    assert set(rows) == set(SITE["quantities"])
    assert rows["z.buoy.mean"]["kind"] == "mean"
    assert "| tension.east-leg.anchor.max |" in page_text(found)
    with pytest.raises(SceneError, match="'east-lag' is not a line; did you mean 'east-leg'"):
        small_site(quantities=["tension.east-lag.max"])


def test_the_start_of_a_case_is_that_of_its_run_and_not_its_first_saved_state():
    model, start = dj.build("double-pendulum-periodic")
    run = dj.simulate("double-pendulum-periodic", dt=0.01, duration=0.02)
    values = QuantityValues(["tension.1.start", "z.2.start"], model, start, run.scene.run)
    found = values.collect()
    np.testing.assert_allclose(found["quantity:tension.1.start"], run.tension[0, 0])
    np.testing.assert_allclose(found["quantity:z.2.start"], run.positions[0, 2, 2])


def test_what_was_run_is_never_run_again_and_other_capacities_need_no_run(folder):
    stronger = small_site(part=[{**SITE["part"][0], "capacity": 1.6e4}], factors={"intact": 2.0, "broken": 2.0})
    assert run_cases(stronger, folder).resumed == 12
    more = small_site(run={**SITE["run"], "seeds": 4})
    store = Store(folder, more)
    assert [store.has(case) for case in more.cases].count(False) == 4  # the fourth seed of four load cases
    longer = small_site(run={**SITE["run"], "duration": 14.0})
    assert not any(Store(folder, longer).has(case) for case in longer.cases)


def same_bits(site, one, other, cases):
    for case in cases:
        a, b = Store(one, site).read(case), Store(other, site).read(case)
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=f"{case}: {name}", strict=True)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_workers_of_a_cluster_give_the_same_bits(site, folder, tmp_path):
    distributed = pytest.importorskip("distributed")
    some = [case for case in site.cases if case.storm.number == 3]
    with distributed.Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        run_cases(site, tmp_path, cases=some, scheduler=client)
    same_bits(site, folder, tmp_path, some)


@pytest.mark.check
def test_runs_killed_at_any_moment_continue_with_the_same_bits(site, folder, tmp_path):
    """`kill -9` of a call with two workers, which end by themselves; the same call again does the rest."""
    (tmp_path / "site.json").write_text(json.dumps(SITE))
    script = (
        "import json, sys\nfrom fitting.farm.cases import run_cases\nfrom fitting.farm.site import read_site\n"
        "if __name__ == '__main__':\n"
        "    run_cases(read_site(json.load(open(sys.argv[1]))), sys.argv[2], workers=2)\n"
    )
    out = tmp_path / "out"
    # given as words, it imports the code that is tested; a file elsewhere would import the installed one
    command = [sys.executable, "-c", script, str(tmp_path / "site.json"), str(out)]
    started = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(list(out.glob("runs/*.npz"))) < 3:
        assert started.poll() is None
        time.sleep(0.01)
    started.send_signal(signal.SIGKILL)
    started.wait()
    kept = len(list(out.glob("runs/*.npz")))
    done = run_cases(site, out)
    assert done.resumed >= min(kept, 3)
    same_bits(site, folder, out, site.cases)


def test_a_file_cut_off_while_it_was_written_counts_as_not_there(site, folder, tmp_path):
    store = Store(tmp_path, site)
    whole = Store(folder, site).file(site.cases[0]).read_bytes()
    store.file(site.cases[0]).write_bytes(whole[: len(whole) // 2])
    assert not store.has(site.cases[0])
    assert store.read(site.cases[0]) is None


def test_a_run_that_an_earlier_version_stored_is_found_under_the_same_name(site, tmp_path):
    with zipfile.ZipFile(Path(__file__).parents[3] / "run" / "saved-files.zip") as archive:
        archive.extractall(tmp_path)
    store = Store(tmp_path / "cases", site)
    assert [store.has(case) for case in site.cases].index(True) == 0
    np.testing.assert_array_equal(store.read(site.cases[0])["largest"], np.arange(4.0))


EFFECT = """
from typing import ClassVar
import jax.numpy as jnp
import dropper_jax as dj

@dj.component
class Nothing(dj.Effect):
    name: ClassVar[str] = "nothing"
    constant: ClassVar[bool] = True

    def force(self, k):
        return jnp.zeros_like(k.r)
"""


def test_runs_with_other_effects_of_the_user_or_own_failures_of_the_scene_are_other_runs(tmp_path, monkeypatch):
    """A change of the file of effects makes stored runs invalid, of scenes that use it only."""
    monkeypatch.setattr(EFFECTS, "data", EFFECTS.data.copy())
    monkeypatch.setattr("fitting.sweep.effect_files.REGISTERED_FILES", [])
    file = tmp_path / "effects.py"
    failure = {"line": "east-leg", "link": 1, "time": 0.1}
    using = {**SCENE, "effects": {**SCENE["effects"], "nothing": {}}}

    def stored_name(scene):
        site = small_site(scene=scene)
        return Store(tmp_path, site).file(site.cases[0]).name

    plain = stored_name(SCENE)
    names = {plain, stored_name({**SCENE, "failure": [failure]})}
    for text in ("a = 1", "a = 2"):
        file.write_text(f"{text}\n{EFFECT}")
        register_file(str(file))
        monkeypatch.setattr("fitting.sweep.effect_files.REGISTERED_FILES", [str(file.resolve())])
        names.add(stored_name(using))
        assert stored_name(SCENE) == plain
    assert len(names) == 4


def test_utilisation_is_factor_times_the_mean_of_the_seeds_maxima_over_capacity(site, folder, found):
    row = found["parts"][0]["cases"][3]
    store = Store(folder, site)
    runs = [store.read(Case(site.storms[3], seed)) for seed in site.seeds]
    lines = np.array([[run["largest"][:2].max(), run["largest"][2:].max()] for run in runs])  # two links each
    means = lines.mean(axis=0)
    worst = int(np.argmax(means))
    assert row["line"] == ("west-leg", "east-leg")[worst]
    np.testing.assert_allclose(row["utilisation"], 1.2 * means[worst] / 8e3)  # a line breaks: 1.2
    np.testing.assert_allclose(row["load_error_n"], lines[:, worst].std(ddof=1) / math.sqrt(3))
    assert row["interval_n"][0] < row["load_n"] < row["interval_n"][1]


def test_at_rest_the_legs_share_the_buoys_lift(found):
    """Two equal legs from 8 m aside: V = half the net lift less half a top link, T = V/sin, sin of 10 m stretched."""
    wet = 9.81 * (1.2 - 1025.0 * math.pi / 4 * 0.03**2) * 10.0
    upward, tension = 0.5 * 9.81 * (1025.0 * 0.2 - 20.0) - 0.25 * wet, 0.0
    for _ in range(20):
        length = 10.0 * (1.0 + tension / 5e4)
        tension = upward / math.sqrt(1.0 - (8.0 / length) ** 2)
    at_rest = found["parts"][0]["cases"][0]["at_rest_n"]
    np.testing.assert_allclose(at_rest, tension, rtol=0.01)  # the leg sags a little


def test_fatigue_goes_by_the_parts_own_curve_and_years_by_the_hours_of_sea_states(found):
    own = found["parts"][0]["fatigue"]
    hourly = [row["damage_per_hour"] for row in found["parts"][0]["cases"]]
    np.testing.assert_allclose(own["damage_per_year"], 100.0 * np.mean(hourly[::2]))  # intact
    assert own["curve"]["source"] == "example"


def test_a_year_without_intact_cases_has_no_damage_of_its_own(folder):
    """The damage of a year is that of the intact farm: cases with a broken line alone do not give it."""
    broken = small_site(cases={**SITE["cases"], "states": ["west-leg"]})
    found = assess(broken, folder)
    own = found["parts"][0]["fatigue"]
    assert (own["damage_per_year"], own["life_years"]) == (None, None)
    assert own["largest_damage_per_hour"] > 0.0
    assert "no intact case is in a sea state with" in page_text(found)


def test_a_part_without_a_curve_has_no_damage(folder):
    bare = small_site(part=[{"name": "legs", "lines": "*-leg", "capacity": 8e3}])
    store = Store(folder, bare)
    one = Store(folder, small_site()).read(bare.cases[0])
    for case in bare.cases:
        store.write(case, one)
    assert assess(bare, folder)["parts"][0]["fatigue"] == {"skipped": "no curve given"}


def test_the_report_states_what_a_reader_must_know(found):
    flags = "\n".join(found["flags"])
    assert "not a final check: 3 of at least 10 seeds" in flags
    assert "exclusion: " in flags  # the buoy drifts when its leg is gone
    assert "not resolved" not in flags
    assert found["parts"][0]["step"]["relative"] < 0.05
    assert not found["passes"]
    assert found["anchors"][1]["worst"]["utilisation"] == max(r["utilisation"] for r in found["anchors"][1]["cases"])


def test_a_step_that_errs_by_more_than_five_per_cent_and_a_missing_run_are_flagged(site, folder):
    coarse = {"legs": {"case": 0, "error_n": 90.0, "relative": 0.08, "value_n": 1.0}}
    assert any("step error 8%" in flag for flag in assess(site, folder, coarse)["flags"])
    more = small_site(run={**SITE["run"], "seeds": 4})
    found = assess(more, folder)
    assert (found["status"], len(found["failed"]), found["passes"]) == ("failed", 4, False)
    assert any("4 of 16 runs are missing" in flag for flag in found["flags"])


def test_two_seeds_have_no_most_probable_maximum_and_the_report_says_so(folder):
    run = {**SITE["run"], "seeds": 2, "characteristic": "most_probable"}
    found = assess(small_site(run=run), folder)
    (flag,) = (flag for flag in found["flags"] if "not the most probable one" in flag)
    assert flag.startswith("part legs, point west-anchor, point east-anchor: the load is the mean of the seeds' maxima")
    run["seeds"] = 3
    assert not any("not the most probable one" in flag for flag in assess(small_site(run=run), folder)["flags"])


def test_a_run_that_fails_is_kept_with_its_reason(tmp_path):
    """Waves that the scene refuses: the case is named, the others go on."""
    bad = small_site()
    runner = CaseRunner(bad)
    runner.scene = lambda case: (_ for _ in ()).throw(dj.SceneError("start: no pose"))
    kept = runner(bad.cases[0])
    assert str(kept["message"]) == "start: no pose"
    Store(tmp_path, bad).write(bad.cases[0], kept)
    row = assess(bad, tmp_path)["failed"][0]
    assert (row["status"], row["why"]) == ("invalid_input", "start: no pose")


def test_the_mean_of_many_maxima_lies_in_its_interval_and_a_longer_storm_is_higher():
    draw = np.random.default_rng(1).gumbel(100.0, 10.0, 20)
    mean, storm = (
        characteristic_load(draw, RunValues(630.0, characteristic=kind)) for kind in ("mean", "most_probable")
    )
    np.testing.assert_allclose(mean.value, draw.mean())
    assert mean.interval[0] < 100.0 + 0.5772 * 10.0 < mean.interval[1]
    # mode + scale ln(18) of the distribution that was drawn from
    assert storm.interval[0] < 100.0 + 10.0 * math.log(18.0) < storm.interval[1]
    assert storm.value > mean.value


def test_the_page_and_the_table_name_parts_by_group(found, tmp_path):
    files = write_page(found, tmp_path)
    text = files["page"].read_text()
    assert "| legs | 2 |" in text
    assert "example, check against your standard" in text
    with files["csv"].open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 + 2 * 4  # a part and two anchors in four cases
    assert {row["state"] for row in rows} == {"intact", "west-leg"}
    assert files["picture"].stat().st_size > 5000


@pytest.fixture(scope="module")
def by_standard(tmp_path_factory):
    """The small site by NS 9415, with its crop at both ends of its spread."""
    seas = [
        {"name": f"{years} years", "hs": hs, "tp": 5.0, "count": 12, "return_period": years}
        for years, hs in ((10, 0.8), (50, 1.0))
    ]
    currents = [
        {"name": name, "speed": speed, "return_period": years}
        for name, speed, years in (("slow", 0.3, 10), ("fast", 0.5, 50))
    ]
    site = small_site(
        sea_state=seas,
        cases={"standard": "ns-9415", "currents": currents, "crops": ["low", "high"]},
        crop={"line_type": {"rope": {"cdn": [1.0, 1.2, 3.9]}}},
        factors={"standard": "ns-9415-rope"},
        run={**SITE["run"], "seeds": 1},
    )
    folder = tmp_path_factory.mktemp("by-standard")
    run_cases(site, folder)
    return assess(site, folder)


@pytest.mark.check
def test_every_number_of_the_page_can_be_followed_to_edition_and_clause(by_standard):
    text, factors = page_text(by_standard), standards("factors")["ns-9415-rope"]
    cases = standards("cases")["ns-9415"]
    assert f"Edition: {cases['edition']}. Clause: {cases['clause']}. Compared with: {cases['checked']}." in text
    assert "| 50 | 10 | 50 years | slow | 2 | 0 |" in text
    assert "| 10 | 50 | 10 years | fast | 2 | 0 |" in text
    row = next(row for row in text.splitlines() if row.startswith("| legs | 3.45 x"))
    worst = by_standard["parts"][0]["worst"]
    assert f"{worst['load_n']:.0f} / 8000 = {3.45 * worst['load_n'] / 8000.0:.3f}" in row
    assert all(f"| {factors[key]} |" in row for key in ("source", "edition", "clause", "checked"))
    assert "ns-9415: the check includes one broken line; `states` has none" in text


@pytest.mark.check
def test_a_rougher_crop_raises_the_mean_load_of_its_case(by_standard):
    rows = {(case["sea_state"], case["crop"]): case["case"] for case in by_standard["cases"]}
    mean = {row["case"]: row["mean_n"] for row in by_standard["parts"][0]["cases"]}
    assert mean[rows["10 years", "high"]] > mean[rows["10 years", "low"]] + 1.0


def test_a_broken_case_has_the_time_of_its_break_and_the_page_shows_it(found):
    times = {case["state"]: case["break_s"] for case in found["cases"]}
    assert times == {"intact": None, "west-leg": 8.0}
    rows = [row for row in page_text(found).splitlines() if row.startswith("| ") and "storm, 0 deg" in row]
    broken = [row for row in rows if "broken" in row]
    assert 0 < len(broken) < len(rows)
    assert all("west-leg broken at 8 s |" in row for row in broken)
    assert not any(" at " in row for row in rows if row not in broken)


def storm_site(hs):
    """A farm of one dropper in a storm of this height [m], as a file."""
    site = {
        "scene": "dropper-farm",
        "parameters": {"droppers": 1},
        "run": {"duration": 60.0, "seeds": 2},
        "sea_state": [{"name": "storm", "hs": hs, "tp": 9.5}],
        "cases": {"directions": [0.0, 90.0]},
        "factors": {"intact": 1.67},
        "part": [{"name": "all", "lines": "*", "capacity": 1e5}],
    }
    return dj.as_toml(site)


def test_the_command_lists_its_cases_and_refuses_what_breaks_before_anything_runs(tmp_path, json_of, printed):
    site, out = tmp_path / "SITE.toml", tmp_path / "out"
    call = ["cases", str(site), "--out", str(out)]
    site.write_text(storm_site(4.2))
    reported = json_of([*call, "--list", "--json"])
    assert (reported["cases"], reported["runs"]) == (["storm, 0 deg", "storm, 90 deg"], 4)
    site.write_text(storm_site(14.2))
    assert "sea_state.0.hs: 'storm' of 14.2 m breaks; allowed: at most" in json_of([*call, "--json"], 2)["error"]
    assert not out.exists()
    assert printed(["season", str(site)], 2).err
    (out / "runs").mkdir(parents=True)
    (out / "runs" / "a.npz").touch()
    assert "already contains runs. Use --resume, or another folder" in printed(call, 2).err
