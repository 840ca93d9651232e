"""Sweeps: the numbers of single runs, whole after a kill, honest about failures."""

import errno
import itertools
import json
import os
import re
import signal

import jax
import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.cli import main

zarr = pytest.importorskip("zarr")
xarray = pytest.importorskip("xarray")

from fitting.cli.sweep import _read_vary  # noqa: E402
from fitting.sweep import SweepStopped, open_sweep, sweep  # noqa: E402
from fitting.sweep.make_plan import from_identity, make_plan  # noqa: E402
from fitting.sweep.store import SweepStore as Store  # noqa: E402

SCENE = rods([1.0, 0.5], 0.5, 1.0, {"linear_damping": {"b_l": 0.1}})
SCENE |= {"name": "swept", "run": {"dt": 0.01, "duration": 0.4, "integrator": "rattle"}}
#: The retries of a step take most of the compilation, and no case here needs them.
QUICK = {"halvings": 0}
VARY = {"b_l": [0.0, 0.1, 0.2, 0.4, 0.8], "start.polar.0": [0.5, 1.0]}


def raw(path) -> dict[str, np.ndarray]:
    return {name: array[:] for name, array in zarr.open_group(path, mode="r").arrays()}


def assert_same_bits(one, other) -> None:
    one, other = raw(one), raw(other)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted sweep of 10 cases in chunks of 4."""
    path = tmp_path_factory.mktemp("sweep") / "whole.zarr"
    result = sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK)
    assert result.counts == {"pending": 0, "ok": 10, "not_converged": 0, "non_finite": 0, "invalid_input": 0}
    return path


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_the_step_of_a_sweep_has_the_verdict_of_runs_of_its_extreme_cases(tmp_path, dt):
    scene = dj.load_scene(SCENE).with_values({"run.dt": dt, "run.duration": 2.0})
    vary = {"b_l": [0.0, 0.2, 0.8]}
    cases = [scene.with_values({"effects.linear_damping.b_l": b_l}) for b_l in (0.0, 0.8)]
    runs = [dj.simulate(case, companion="coarser", **QUICK) for case in cases]
    verdict = sweep(scene, vary, tmp_path / "swept.zarr", **QUICK).verdict
    too_long = any(run.status == "step_too_long" for run in runs)
    assert verdict.status == ("step_too_long" if too_long else "ok")
    assert any("may be off by" in text for run in runs for text in run.warnings) == (dt > 0.01)
    for b_l, run in zip((0, 0.8), runs, strict=True):
        for text in (text for text in run.warnings if "may be off by" in text):
            assert f"effects.linear_damping.b_l = {b_l}: {text}" in verdict.warnings
    with open_sweep(tmp_path / "swept.zarr") as found:
        assert found.attrs["step_check"]["status"] == verdict.status
    assert sweep(scene, vary, tmp_path / "swept.zarr", **QUICK).verdict == verdict  # resumed, nothing runs


def test_corners_of_a_grid_and_outermost_rows_of_a_list_are_extreme():
    def extremes(b_l, **settings):
        plan = make_plan(SCENE, {"b_l": b_l, "start.polar.0": [0.5, 1.0, 0.7]}, **settings)
        paths = "effects.linear_damping.b_l", "start.polar.0"
        return sorted(tuple(map(scene.value, paths)) for scene in plan.extreme_cases().values())

    assert extremes([0.1, 0.2, 0.4]) == [(0.1, 0.5), (0.1, 1.0), (0.4, 0.5), (0.4, 1.0)]
    assert {0.1, 0.4} <= {b_l for b_l, _ in extremes([0.1, 0.4, 0.2], listed=True)}
    # links of 0.73 m in all reach 0.66 m, and no longer when one of 0.104 m has 0.02 m: the scene rejects this corner
    plan = make_plan("dropper-release-a", {"point.right.position.0": [0.28, 0.66], "line.0.length.0": [0.104, 0.02]})
    assert len(plan.extreme_cases()) == 3
    assert "point.right.position.0 = 0.66, line.0.length.0 = 0.02" not in plan.extreme_cases()


def test_sweep_gives_the_numbers_of_single_runs_and_plain_xarray_reads_its_inputs_as_coordinates(whole):
    with xarray.open_zarr(whole) as flat:  # its metadata are consolidated: no warning, which here is an error
        assert set(flat.coords) == {"b_l", "start.polar.0"}
        assert flat.sizes["case"] == 10
        assert flat.tension_max.attrs["units"] == "N"
    found = open_sweep(whole)
    for b_l, polar in ((0.0, 0.5), (0.4, 1.0)):
        scene = dj.load_scene(SCENE).with_values({"effects.linear_damping.b_l": b_l, "start.polar.0": polar})
        run = dj.simulate(scene, **QUICK)
        case = found.sel({"b_l": b_l, "start.polar.0": polar})
        tension = run.tension[1:]
        links = np.diff(run.positions[1:], axis=1)
        expected = {
            "tension_max": tension.max(),
            "tension_min": tension.min(),
            "tension_mean": tension.mean(),
            "energy_final": run.energy[-1],
            "excursion": np.linalg.norm(run.positions - run.positions[0], axis=-1).max(),
            "angle_max": np.arccos(-links[..., 2] / 0.5).max(axis=0),
            "positions": run.positions[1:, 1:],
            "tension": tension,
        }
        for name, value in expected.items():
            np.testing.assert_allclose(case[name].values, value, rtol=1e-9, atol=1e-9, err_msg=name)


def test_a_value_given_twice_has_its_result_twice(tmp_path, whole):
    sweep(SCENE, {"start.polar.0": [1.0, 0.5], "b_l": [0.4, 0.0, 0.4]}, tmp_path / "twice.zarr", chunk=4, **QUICK)
    with open_sweep(tmp_path / "twice.zarr") as found:
        assert found.b_l.values.tolist() == [0.0, 0.4, 0.4]
        grid = open_sweep(whole).tension_max.sel({"b_l": [0.0, 0.4, 0.4]})
        np.testing.assert_array_equal(found.tension_max.transpose(*grid.dims), grid)


@pytest.mark.parametrize("every", [1, 8])
def test_quantities_by_name_are_those_of_single_runs_and_extremes_those_of_all_steps(tmp_path, every):
    names = ["tension.chain.fairlead.max", "tension.chain.first.min", "anchor.pivot.horizontal.max", "z.tip.final"]
    names += ["tension.chain.first.start", "tension_max", "tension_min"]
    scene = {**SCENE, "run": {**SCENE["run"], "save_every": every}}
    found = sweep(scene, {"b_l": [0.1, 0.4]}, tmp_path / "named.zarr", quantities=names, **QUICK).path
    run = dj.simulate(dj.load_scene(SCENE).with_values({"effects.linear_damping.b_l": 0.4}), **QUICK)
    case, tension = open_sweep(found).sel({"b_l": 0.4}), run.tension[1:]
    across = np.linalg.norm(run.positions[1:, 1, :2], axis=-1) / 0.5 * run.tension[1:, 0]
    expected = (tension[:, 1].max(), tension[:, 0].min(), across.max(), run.positions[-1, 2, 2])
    expected += (run.tension[0, 0], tension.max(), tension.min())
    # saved maxima are vertices of parabolas through samples, which are 10 ms apart
    rtol = [0.02, 0.02, 0.02] if every == 1 else [1e-9, 1e-9, 1e-9]
    assert every == 1 or tension[7::8].max() < 0.999 * tension.max()
    for name, value, within in zip(names, expected, [*rtol, 1e-9, 1e-9, 1e-9, 1e-9], strict=True):
        np.testing.assert_allclose(case[name], value, rtol=within, err_msg=name)
    assert case["tension.chain.fairlead.max"].attrs["units"] == "N"


@pytest.mark.check
@pytest.mark.parametrize(("backend", "chunk"), [("cpu", 1), ("gpu", 6)])
def test_cases_of_a_system_run_one_by_one_or_on_a_gpu_together_and_are_those_of_single_runs(
    tmp_path, monkeypatch, backend, chunk
):
    plain = {key: SCENE[key] for key in ("name", "effects")}
    plain["run"] = {"dt": 0.01, "duration": 0.2}
    points = {"top": [0.0, 0.0, 0.0], "middle": [0.5, 0.0, -0.5], "end": [1.0, 0.0, 0.0]}
    plain["point"] = [
        {"name": name, "position": position, **({"kind": "free", "mass": 2.0} if name == "middle" else {})}
        for name, position in points.items()
    ]
    rope = {"links": 2, "length": 0.75, "mass": 1.0, "axial": {"law": "elastic", "EA": 1e4}}
    plain["line"] = [{"name": to, "from": "middle", "to": to, **rope} for to in ("top", "end")]
    values = [[0.1, 0.4], [1.0, 2.0, 4.0]]
    with monkeypatch.context() as patched:
        patched.setattr(jax, "default_backend", lambda: backend)
        result = sweep(plain, {"b_l": values[0], "point.middle.mass": values[1]}, tmp_path / "system.zarr")
    assert (result.plan.chunk, result.counts["ok"]) == (chunk, 6)
    with open_sweep(result.path) as found:
        for case in itertools.product(*values):
            changes = {"effects.linear_damping.b_l": case[0], "point.middle.mass": case[1]}
            run = dj.simulate(dj.load_scene(plain).with_values(changes))
            one = found.sel({"b_l": case[0], found.tension_max.dims[1]: case[1]})
            np.testing.assert_allclose(one.tension_max, run.tension[1:].max(), rtol=1e-9)
            np.testing.assert_allclose(one.energy_final, run.kinetic[-1] + run.potential[-1], rtol=1e-9)


#: A chain of `count` links, drawn aside at its first node and released.
CHAIN = {
    **{key: SCENE[key] for key in ("name", "run", "effects")},
    "parameters": {"count": 2, "size": 0.5},
    "point": [SCENE["point"][0], {"name": "tip", "kind": "free", "position": [0.0, 0.0, -1.0]}],
    "line": [{**SCENE["line"][0], "links": "= count", "length": "= size"}],
    "start": {"release_nodes": [1], "release_force": [[5.0, 0.0, 0.0]]},
}


@pytest.mark.check
def test_each_shape_of_the_model_gets_its_program_and_the_numbers_of_single_runs(tmp_path):
    """One chunk holds both shapes; arrays over links have those of the larger one."""
    counts, dampings = [2, 3], [0.1, 0.4]
    vary = {"parameters.count": counts, "b_l": dampings}
    result = sweep(CHAIN, vary, tmp_path / "shapes.zarr", chunk=4, quantities=["tension_max", "angle_max"], **QUICK)
    assert result.counts["ok"] == 4
    with open_sweep(result.path) as found:
        assert found.angle_max.shape == (2, 2, 3)
        for count, b_l in itertools.product(counts, dampings):
            values = {"parameters.count": count, "effects.linear_damping.b_l": b_l}
            run = dj.simulate(dj.load_scene(CHAIN).with_values(values))
            one = found.sel(count=count, b_l=b_l)
            np.testing.assert_allclose(one.tension_max, run.tension[1:].max(), rtol=1e-9)
            down = -np.diff(run.positions, axis=1)[1:, :, 2] / 0.5
            np.testing.assert_allclose(one.angle_max[:count], np.arccos(down.min(axis=0)), rtol=1e-6)
            assert np.isnan(one.angle_max[count:]).all()


@pytest.mark.parametrize("scene", ["dropper-farm-2", "farm"])
def test_parameters_of_a_template_survive_the_identity_of_a_sweep(tmp_path, scene):
    """Workers make the plan from its identity."""
    name = {"dropper-farm-2": "parameters.droppers", "farm": "parameters.loops"}[scene]
    if scene == "farm":
        assert main(["new", "farm", str(tmp_path / "farm.toml")]) == 0
        scene = tmp_path / "farm.toml"
    plan = make_plan(scene, {name: [2, 3], "parameters.current": [0.1, 0.2]}, quantities=["tension_max"])
    again = from_identity(json.loads(json.dumps(plan.identity())))
    assert again.identity() == plan.identity()
    assert [axis.resizes for axis in again.axes] == [True, False]
    assert again.links == dj.load_scene(scene).with_values({name: 3}).line.links


def test_evenly_spaced_values_of_a_parameter_are_whole_where_they_can_be():
    """A count takes whole numbers only."""
    assert [type(x) for x in _read_vary("parameters.droppers=2:8:4")[1].tolist()] == [int] * 4
    assert _read_vary("parameters.leg=38:40:5")[1].tolist() == [38.0, 38.5, 39.0, 39.5, 40.0]
    assert _read_vary("b_l=0:1:2")[1].dtype == float


def test_a_start_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def fail(*_):
        raise SceneError("no equilibrium")

    monkeypatch.setattr("fitting.sweep.program.Program.compile", fail)
    with pytest.raises(SceneError, match="no equilibrium"):
        sweep(SCENE, {"b_l": [0.3]}, tmp_path / "failed.zarr", quantities=["tension_max"], **QUICK)
    assert list(tmp_path.iterdir()) == []


def test_resumed_after_a_cut_is_the_uninterrupted_sweep_to_the_bit(whole, tmp_path, monkeypatch):
    path = tmp_path / "cut.zarr"
    write = Store.write

    def cut(self, chunk, found):
        if chunk == 1:  # in the middle of a chunk: some arrays are there, the status is not
            self.group["tension_max"][4:8] = -1.0
            raise KeyboardInterrupt
        write(self, chunk, found)

    monkeypatch.setattr(Store, "write", cut)
    with pytest.raises(KeyboardInterrupt):
        sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK)
    monkeypatch.setattr(Store, "write", write)
    status = next(path.glob("status/c/0"))
    result = sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK)
    assert result.resumed == 4
    assert_same_bits(path, whole)
    status.write_bytes(b"")  # a status file cut off as it was written
    assert sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK).resumed == 6
    assert_same_bits(path, whole)


def test_a_folder_of_other_inputs_is_refused_with_what_differs(whole, tmp_path, refusal):
    settings = {"chunk": 4, "traces": True, **QUICK}
    other = refusal(sweep, SCENE, {**VARY, "b_l": [0.0, 0.3]}, whole, **settings)
    assert re.search(r"belongs to other inputs: vary\.effects\.linear_damping\.b_l = .* there, .* here", other)
    changed = {**SCENE, "run": {**SCENE["run"], "dt": 0.005}}
    assert "scene.run.dt = 0.01 there, 0.005 here" in refusal(sweep, changed, VARY, whole, **settings)
    (tmp_path / "folder").mkdir()
    assert "exists but is not a sweep" in refusal(sweep, SCENE, VARY, tmp_path / "folder")


def test_failed_members_are_recorded_and_affect_no_other(tmp_path):
    """A link that turns many times within a step has no step to take."""
    path = tmp_path / "failed.zarr"
    scene = {**SCENE, "start": {**SCENE["start"], "polar_rate": [0.0, 0.0]}}
    result = sweep(scene, {"start.polar_rate.0": [0.0, 1e4]}, path, quantities=["tension_max"], **QUICK)
    found = open_sweep(path)
    assert result.counts["ok"] == 1
    assert result.counts["not_converged"] + result.counts["non_finite"] == 1
    assert found.status.values[0] == 0
    assert np.isfinite(found.tension_max.values[0])
    assert np.isnan(found.tension_max.values[1])
    assert found.failed_at.values[1] > 0


@pytest.mark.parametrize("path", ["b_l", "line.0.mass.0"])
@pytest.mark.parametrize("values", [[-1.0, 0.2, 0.1], [0.2, -1.0, 0.1], [0.2, 0.1, -1.0]])
def test_an_invalid_value_is_one_failed_case_at_any_position(tmp_path, path, values):
    result = sweep(SCENE, {path: values}, tmp_path / "s.zarr", quantities=["tension_max"], **QUICK)
    assert (result.counts["ok"], result.counts["invalid_input"]) == (2, 1)
    with open_sweep(result.path) as found:
        assert found.status.values.tolist() == [3 if value < 0.0 else 0 for value in values]
        assert np.isnan(found.tension_max.values).tolist() == [value < 0.0 for value in values]


def test_a_grid_with_an_invalid_first_row_and_column_has_the_numbers_of_the_others(tmp_path, whole):
    vary = {"b_l": [-1.0, 0.2, 0.8], "start.polar.0": [0.5, 1.0], "line.0.mass.1": [-0.5, 1.0]}
    result = sweep(SCENE, vary, tmp_path / "s.zarr", quantities=["tension_max"], **QUICK)
    assert (result.counts["ok"], result.counts["invalid_input"]) == (4, 8)
    with open_sweep(result.path) as found, open_sweep(whole) as grid:
        some = found.tension_max.sel({found.tension_max.dims[2]: 1.0, "b_l": [0.2, 0.8]})
        np.testing.assert_allclose(some, grid.tension_max.sel({"b_l": [0.2, 0.8]}), rtol=1e-9)


def test_full_disk_is_reported_and_what_is_there_stays(whole, tmp_path, monkeypatch):
    path = tmp_path / "full.zarr"
    write = Store.write

    def full(self, chunk, found):
        if chunk == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, chunk, found)

    monkeypatch.setattr(Store, "write", full)
    with pytest.raises(SweepStopped, match="No space left on device; 8 of 10 cases are kept, the same call resumes"):
        sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK)
    monkeypatch.setattr(Store, "write", write)
    assert sweep(SCENE, VARY, path, chunk=4, traces=True, **QUICK).resumed == 8
    assert_same_bits(path, whole)


@pytest.mark.parametrize(
    ("vary", "more", "message"),
    [
        ({}, {}, "vary: nothing is varied"),
        ({"b_m": [1.0]}, {}, "vary: 'b_m' does not exist"),
        ({"effects.linear_damping.b_x": [1.0]}, {}, "effects.linear_damping.b_x: unknown path"),
        ({"b_l": [-1.0]}, {}, "b_l"),
        *(
            ({"b_l": x}, {}, "vary: b_l: no finite numbers")
            for x in ([], 0.3, [[0.1, 0.2]], [0.1, np.nan], [np.inf], ["0.1", "0.2"], [True, False])
        ),
        (
            {"line.0.mass": [1.0], "line.chain.mass": [2.0]},
            {},
            "'line.0.mass' and 'line.chain.mass' are the same number",
        ),
        ({"start.polar.0": [1.0], "start.polar.1": [2.0]}, {"seeds": 2}, "seeds: nothing in this scene is random"),
        ({"run.dt": [0.1]}, {}, "vary: 'run.dt' belongs to the compiled program"),
        ({"b_l": [0.1]}, {"quantities": ["tension_mx"]}, "quantities: 'tension_mx' is unknown; did you mean"),
        ({"b_l": [0.1]}, {"quantities": ["tension.m.max"]}, "'tension.m.max': 'm' is not a line; known: chain"),
        ({"b_l": [0.1, 0.2], "start.polar.0": [1.0]}, {"listed": True}, "lists of different lengths (b_l 2, start"),
        ({"b_l": [0.1]}, {"duratoin": 0.2}, "duratoin: unknown setting; did you mean 'duration'?"),
        ({"b_l": [0.1]}, {"duration": -0.2}, "run.duration: -0.2"),
        ({"b_l": [0.1]}, {"listed": True, "seeds": 2}, "listed: seeds, which rows cannot have separately"),
    ],
)
def test_mistakes_are_one_line(tmp_path, vary, more, message, refusal):
    assert message in refusal(sweep, SCENE, vary, tmp_path / "s.zarr", **more)
    assert not (tmp_path / "s.zarr").exists()


def test_settings_are_keys_of_run_or_of_the_stepper():
    plan = make_plan(SCENE, {"b_l": [0.0, 0.1]}, duration=0.2, integrator="theta", gamma=0.8, halvings=0)
    run = plan.scene.run
    assert (run.duration, run.integrator, run.options) == (0.2, "theta", {"gamma": 0.8})
    assert dict(plan.settings) == {"halvings": 0}


def test_seeds_are_realisations_of_the_sea():
    waves = {"kind": "spectrum", "hs": 1.0, "tp": 6.0, "count": 8, "seed": 5}
    line = [{**SCENE["line"][0], "diameter": 0.05}]
    effects = {"weight": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.0}}
    wet = {**SCENE, "line": line, "effects": effects, "sea": {"depth": 30.0, "waves": waves}}
    plan = make_plan(wet, {}, seeds=3)
    assert plan.inputs(np.arange(3))[:, 0].tolist() == [5.0, 6.0, 7.0]
    assert [axis.path for axis in make_plan(wet, {"sea.depth": [20.0, 30.0]}).axes] == ["sea.depth"]


def test_listed_values_go_together_and_give_the_numbers_of_the_grid(whole, tmp_path):
    rows = {"b_l": [0.2, 0.0, 0.8], "start.polar.0": [1.0, 0.5, 0.5]}
    result = sweep(SCENE, rows, tmp_path / "rows.zarr", chunk=4, traces=True, listed=True, **QUICK)
    assert result.cases == 3
    again = sweep(SCENE, rows, tmp_path / "rows.zarr", chunk=4, traces=True, listed=True, **QUICK)
    assert again.resumed == 3
    with open_sweep(tmp_path / "rows.zarr") as found, open_sweep(whole) as grid:
        assert found.b_l.dims == ("case",)
        for case, (b_l, polar) in enumerate(zip(*rows.values(), strict=True)):
            one = grid.sel({grid.tension_max.dims[0]: b_l, grid.tension_max.dims[1]: polar})
            assert float(found.tension_max[case]) == pytest.approx(float(one.tension_max), rel=1e-9)
    with pytest.raises(SceneError, match="listed"):
        sweep(SCENE, rows, tmp_path / "rows.zarr", chunk=4, traces=True, **QUICK)


def test_command_line_sweeps_and_resumes(tmp_path, printed, json_of):
    out = tmp_path / "cli.zarr"
    argv = ["sweep", "double-pendulum-periodic", "--integrator", "rattle", "--dt", "0.01", "--duration", "0.1"]
    argv += ["--vary", "line.0.mass=0.5:1.5:3", "--quantities", "tension_max", "--out", str(out), "--quiet", "--json"]
    found = json_of(argv)
    assert (found["status"], found["cases"], found["resumed"], found["failed"]) == ("ok", 3, 0, 0)
    assert found["warnings"] == []
    tension = open_sweep(out).tension_max.values
    np.testing.assert_allclose(tension / tension[1], [0.5, 1.0, 1.5], rtol=1e-9)  # weights and inertia scale alike
    assert json_of([*argv, "--plot", str(tmp_path / "plots")])["resumed"] == 3
    assert [path.name for path in (tmp_path / "plots").iterdir()] == ["tension_max.png"]
    rows = [line.split() for line in printed([word for word in argv if word != "--json"]).out.splitlines()]
    first = rows.index(["mass", "[kg]", "tension_max", "[N]"]) + 1
    np.testing.assert_allclose(np.array(rows[first : first + 3], float)[:, 1], tension, rtol=1e-3)
    wrong = [*argv[: argv.index("--out")], "--out", str(tmp_path / "cli.npz"), "--json"]
    assert "cli.npz' has no known suffix; allowed: .zarr, or a folder without suffix" in json_of(wrong, 2)["error"]
    assert not (tmp_path / "cli.npz").exists()
    assert "is not NAME=LO:HI:N" in json_of([*argv, "--vary", "line.0.length=oops"], 2)["error"]


@pytest.mark.check
def test_cluster_does_the_chunks_of_a_worker_that_died_elsewhere(whole, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    path, write, killed = tmp_path / "cluster.zarr", Store.write, []
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        workers = list(client.run(os.getpid).values())

        def kill_one(self, chunk, found):
            write(self, chunk, found)
            if not killed:
                killed.append(workers[0])
                os.kill(workers[0], signal.SIGKILL)

        monkeypatch.setattr(Store, "write", kill_one)
        result = sweep(SCENE, VARY, path, chunk=1, traces=True, scheduler=client, **QUICK)
    assert killed
    assert result.counts["ok"] == 10
    one, other = raw(path), raw(whole)
    np.testing.assert_array_equal(one["status"], other["status"])
    np.testing.assert_allclose(one["tension_max"], other["tension_max"], rtol=1e-9)


def test_a_list_that_ends_with_its_first_value_is_set_where_others_are():
    """A mass is in the pose at the start too: it goes through the scene."""
    lists = ([0.033, 0.04], [0.033, 0.04, 0.033])
    plans = [make_plan("dropper-release-a", {"line.0.mass": values}) for values in lists]
    assert [plan.axes[0].parameters for plan in plans] == [(), ()]
