"""Labelled runs: loads, arc lengths, the surface, against what defines them; CF by its checker where that is there."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError, Solution
from dropper_jax.run.labelled import select_line

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def solution(longline):
    return longline()


@pytest.fixture(scope="module")
def file(solution, tmp_path_factory):
    return solution.save(tmp_path_factory.mktemp("labelled") / "run.nc")


@pytest.fixture(scope="module")
def opened(file):
    with xarray.open_dataset(file, engine="h5netcdf") as dataset:
        yield dataset.load()


def test_arc_length_runs_from_the_beginning_of_each_line(solution, opened):
    backbone = select_line(opened, "backbone")
    np.testing.assert_allclose(backbone.arc_length_of_node, 30.5 * np.arange(4) / 3)
    np.testing.assert_allclose(backbone.arc_length_of_link, 30.5 * (np.arange(3) + 0.5) / 3)
    np.testing.assert_array_equal(backbone.position, solution.positions[:, 5:9])
    np.testing.assert_array_equal(backbone.tension, solution.tension[:, 4:7])
    np.testing.assert_array_equal(backbone.end_tension, solution.tension[:, [4, 6]])
    with pytest.raises(SceneError, match=r"line: 'sok' is not a line.*sock"):
        select_line(opened, "sok")


def test_load_of_an_anchor_is_its_legs_tension_along_the_leg(solution, opened):
    load = opened.point_load.sel(held_point="anchor-a")
    # at rest at t = 0, to which the first tension belongs; half a link under water hangs on the anchor
    along = solution.positions[0, 1] - solution.positions[0, 0]
    leg = solution.scene.lines[0]
    water = 1025.0 * np.pi / 4 * leg.diameter[0] ** 2 * leg.length[0] if "buoyancy" in solution.scene.effects else 0.0
    half_link = 0.5 * 9.81 * (leg.mass[0] - water)
    expected = solution.tension[0, 0] * along / np.linalg.norm(along) - [0.0, 0.0, half_link]
    np.testing.assert_allclose(load[0], expected)


def test_elevation_is_the_regular_wave_at_the_origin(solution, opened):
    expected = 0.8 * np.cos(2 * np.pi / 6.0 * solution.t)
    np.testing.assert_allclose(opened.elevation, expected, atol=1e-6)
    assert opened.elevation.attrs["standard_name"] == "sea_surface_height_above_mean_sea_level"


def test_a_file_gives_back_the_run_its_names_and_times(solution, file, opened):
    assert Solution.load(file).work_names == solution.work_names
    assert opened.position.sel(axis="z").dims == ("time", "node")
    assert opened.step_status.attrs["flag_meanings"] == "good failed"
    np.testing.assert_array_equal(opened.step_status.attrs["flag_values"], [0, 1])
    # its time counts seconds from a date
    passed = (opened.time.values - np.datetime64("2000-01-01")) / np.timedelta64(1, "ns")
    np.testing.assert_allclose(1e-9 * passed, solution.t, atol=1e-9)


@pytest.mark.check
def test_cf_checker_finds_no_error_and_does_not_stumble(file, tmp_path):
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    program = shutil.which("compliance-checker", path=places)
    if program is None:
        pytest.skip("compliance-checker is not installed")
    out = tmp_path / "found.json"
    command = [program, "-t", "cf:1.11", "-f", "json", "-o", str(out), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert "exceptions occurred" not in done.stderr + done.stdout
    found = json.loads(out.read_text())["cf:1.11"]
    assert found["scored_points"] > 50
    errors = [msg for row in found["high_priorities"] if row["value"][0] < row["value"][1] for msg in row["msgs"]]
    assert errors == []


@pytest.mark.check
@pytest.mark.skipif(importlib.util.find_spec("pyvista") is None, reason="pyvista is not installed")
def test_paraview_files_are_read_back_by_another_reader(solution, tmp_path):
    import pyvista

    from dropper_jax import write_vtk

    reader = pyvista.get_reader(str(write_vtk(solution, tmp_path, every=10)))
    np.testing.assert_allclose(reader.time_values, solution.t[::10])
    reader.set_active_time_value(reader.time_values[2])
    lines = reader.read()[0]
    np.testing.assert_array_equal(lines.points, solution.positions[20])
    np.testing.assert_array_equal(lines.cell_data["tension"], solution.tension[20])
    assert lines.n_lines == solution.tension.shape[1]
