"""Saved runs: netCDF and npz give back the same numbers through one loader; tables are what fitting reads."""

from dataclasses import replace

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import Solution
from dropper_jax.quantities.variables import ARRAYS
from dropper_jax.run.summary import write_angles, write_tensions
from fitting import read_trace

xarray = pytest.importorskip("xarray")
pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def run():
    return dj.simulate("double-pendulum-chaotic", duration=0.2, dt=0.01)


@pytest.mark.parametrize("suffix", ["npz", "nc"])
def test_a_file_gives_back_every_number_and_setting(run, tmp_path, suffix):
    again = Solution.load(run.save(tmp_path / f"run.{suffix}"))
    for name, saved in {**{name: getattr(run, name) for name in ARRAYS}, **run.last}.items():
        read = again.last[name] if name in run.last else getattr(again, name)
        assert saved.dtype == read.dtype, name
        np.testing.assert_array_equal(saved, read, err_msg=name)
    assert again.last.keys() == run.last.keys()
    assert again.provenance() == run.provenance()
    assert again.scene == run.scene
    assert [item.name for item in tmp_path.iterdir()] == [f"run.{suffix}"]


def test_another_suffix_is_refused_before_anything_is_written(run, tmp_path):
    with pytest.raises(dj.SceneError, match=r"run\.csv: \.csv is an unknown format; allowed: \.npz, \.nc, \.zarr"):
        run.save(tmp_path / "run.csv")
    assert not list(tmp_path.iterdir())


def test_dataset_has_names_units_and_the_angles_of_the_solution(run):
    dataset = run.to_xarray()
    assert dataset.attrs["Conventions"].startswith("CF-")
    assert all("units" in dataset[name].attrs and "long_name" in dataset[name].attrs for name in dataset.data_vars)
    height = dataset.position.sel(axis="z", node=2).isel(time=0).item()
    assert height == run.positions[0, 2, 2]
    np.testing.assert_array_equal(dataset.polar_angle.values, run.polar)
    assert dataset.tension.dims == ("time", "link")
    assert "steps of 0.01 s" in dataset.attrs["source"]
    followed = replace(run, scene=run.scene.with_values({"run.accuracy": 0.02}))
    assert "accuracy 0.02" in followed.to_xarray().attrs["source"]


def test_command_line_writes_netcdf_and_tables(tmp_path, json_of):
    out, tables = tmp_path / "run.nc", tmp_path / "tables"
    argv = ["run", "double-pendulum-chaotic", "--duration", "0.2", "--dt", "0.01", "--quiet", "--json"]
    found = json_of([*argv, "--out", str(out), "--tables", str(tables)])
    assert Solution.load(out).summary()["final_positions_m"] == found["final_positions_m"]
    assert sorted(item.name for item in tables.iterdir()) == ["angles.csv", "tensions.csv"]


@pytest.mark.parametrize("zero", ["horizontal", "down"])
def test_angle_table_is_read_back_exactly_and_means_the_same(run, tmp_path, zero):
    path = write_angles(run, tmp_path / "angles.csv", zero=zero)
    trace = read_trace(path, links=2)
    assert (trace.convention.zero, trace.convention.sign, trace.convention.unit) == (zero, 1, "rad")
    np.testing.assert_array_equal(trace.t, run.t)
    inside = trace.in_model_convention(trace.convention)
    np.testing.assert_allclose(np.sin(inside.theta), np.sin(run.polar), atol=1e-12)
    columns = path.read_text().splitlines()[2].split(",")
    rates = np.loadtxt(path, delimiter=",", skiprows=3)[:, [columns.index(f"omega_{j}") for j in (1, 2)]]
    slope = np.gradient(trace.theta, run.t, axis=0)
    assert np.abs(slope - rates)[2:-2].max() < 0.02 * np.abs(rates).max()


def test_the_angle_table_states_the_error_of_the_runs_step(run, tmp_path):
    assert read_trace(write_angles(run, tmp_path / "angles.csv")).model_error == 0.0
    checked = replace(run, settings={**run.settings, "stated_errors": {"angles_rad": 2.345e-4}})
    path = write_angles(checked, tmp_path / "angles.csv")
    assert read_trace(path).model_error == 2.3e-4
    table = np.loadtxt(path, delimiter=",", skiprows=3)
    np.testing.assert_array_equal(table[:, 0], run.t)


def test_tension_table_holds_the_tensions_at_their_times(run, tmp_path):
    table = np.loadtxt(write_tensions(run, tmp_path / "tensions.csv"), delimiter=",", skiprows=3)
    np.testing.assert_array_equal(table[:, 0], run.t_tension)
    np.testing.assert_array_equal(table[:, 1:], run.tension)


def test_systems_of_lines_keep_their_names_in_netcdf_and_tables(longline, tmp_path):
    solution = longline()
    again = Solution.load(solution.save(tmp_path / "system.nc"))
    np.testing.assert_array_equal(again.positions, solution.positions)
    assert again.scene == solution.scene
    dataset = solution.to_xarray()
    backbone = dataset.position.where(dataset.line_of_node == "backbone", drop=True)
    np.testing.assert_array_equal(backbone.values, solution.positions[:, 5:9])
    np.testing.assert_array_equal(dataset.tension.sel(link="sock/6").values, solution.tension[:, -1])
    for write, stem in ((write_angles, "theta"), (write_tensions, "tension")):
        lines = write(solution, tmp_path / f"{stem}.csv").read_text().splitlines()
        head = next(line for line in lines if not line.startswith("#")).split(",")
        assert head[1:6] == [f"{stem}_leg-a/{j}" for j in (1, 2, 3, 4)] + [f"{stem}_backbone/1"]
    table = np.genfromtxt(tmp_path / "theta.csv", delimiter=",", skip_header=3)
    np.testing.assert_array_equal(table[:, 1:18], solution.polar)


def test_the_state_from_which_a_run_continues_is_a_group_of_the_file(run, tmp_path):
    path = run.save(tmp_path / "run.nc")
    with xarray.open_dataset(path, engine="h5netcdf") as dataset:
        names = [str(name) for name in dataset.variables]
    assert {"position", "velocity", "tension"} <= set(names)
    assert [name for name in names if name.startswith("last_")] == []
    with xarray.open_dataset(path, engine="h5netcdf", group="restart") as restart:
        assert set(map(str, restart.variables)) == set(run.last)
    older = tmp_path / "older.nc"  # a file of before, with these among its other variables
    run.to_xarray().to_netcdf(older, engine="h5netcdf")
    assert set(Solution.load(older).last) == set(run.last)
