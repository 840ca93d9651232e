"""Motion out of the plane is distinguished from a slanting camera and a lens, and the fit of such a film reports it."""

import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from fitting import Convention, Motion, View, film, read_trace, write_trace, write_video
from fitting.films import track
from fitting.films.out_of_plane import OUT_OF_PLANE, out_of_plane
from fitting.traces.conventions import settle_convention

POLAR = np.array([1.2, 0.9, 0.6])


def chain(kick: float) -> dict:
    """Three links of 0.1 m at angles from straight down, the tip kicked across [m/s]."""
    steps = 0.1 * np.stack([np.sin(POLAR), 0 * POLAR, -np.cos(POLAR)], axis=1)
    nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    velocities = np.zeros((4, 3))
    velocities[3, 1] = kick
    return rods(POLAR.tolist(), 0.1, 0.05, {"linear_damping": {"b_l": 0.005}}) | {
        "run": {"dt": 1 / 960, "duration": 2.5, "save_every": 4},
        "start": {"kind": "positions", "positions": nodes.tolist(), "velocities": velocities.tolist()},
    }


@pytest.fixture(scope="module")
def runs():
    """By kick, the motion."""
    return {kick: dj.simulate(chain(kick)) for kick in (0.0, 0.15)}


@pytest.mark.parametrize("slant", [(0.0, 0.0), (0.1, -0.05)])
@pytest.mark.parametrize("bending", [(0.0, 0.0), (-0.1, 0.02)])
def test_a_kick_out_of_the_plane_is_distinguished_from_slant_and_lens(runs, slant, bending):
    view = View(slant=slant, bending=bending, centre=(0.1, -0.15))
    noise = 0.1 * np.random.default_rng(0).standard_normal(runs[0.0].positions[..., :2].shape)
    found = {}
    for kick, run in runs.items():
        pixels = np.stack([view.to_pixels(places) for places in run.positions[..., [0, 2]]]) + noise
        found[kick] = out_of_plane(pixels, np.ones(pixels.shape[:2], bool)[:, 1:]).max()
    assert found[0.0] < 0.5 * OUT_OF_PLANE
    assert found[0.15] > 2 * OUT_OF_PLANE


@pytest.mark.check
@pytest.mark.parametrize("kick", [0.0, 0.15])
def test_tracker_and_fit_report_that_a_kicked_chain_leaves_its_plane(runs, tmp_path, kick):
    run = runs[kick]
    view = View(size=(400, 300), focus=500.0, centre=(0.1, -0.15), distance=0.9)
    path = tmp_path / "chain.avi"
    write_video(path, film(Motion(run.t, run.positions), view, 60.0), 60.0)
    tracked = track(path, 4, distance=None)
    assert tracked.status == "ok"
    reported = [line for line in tracked.warnings if "out of the plane" in line]
    assert bool(reported) == bool(kick)
    trace = read_trace(write_trace(tmp_path / "chain.csv", tracked.trace, ["marked nothing"]))
    assert trace.warnings == tracked.trace.warnings
    model, _ = dj.build(dj.load_scene(chain(0.0)))
    _, warnings = settle_convention(trace, model, Convention())
    assert any("chain: motion out of the plane" in line for line in warnings) == bool(kick)
