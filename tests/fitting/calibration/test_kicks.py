"""Kicks of a simulated rig: found with their times, and what they disturb is left out."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import integrate
from fitting import Camera, FitSettings, Motion, observe, prepare
from fitting.calibration.kicks import without_kicks
from fitting.calibration.summarise import summarise
from fitting.windows.method import estimate
from fitting.windows.sound_windows import with_sound_windows

RATE, DURATION, KICK, TRUTH = 60.0, 12.0, 5.0, 4e-3
DAMPING = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]


@pytest.fixture(scope="module")
def rig(chain):
    """`rig(damping)`: four links between two hooks, lifted at a node."""
    length, mass = [0.15, 0.14, 0.16, 0.15], [0.05, 0.06, 0.05, 0.05]
    start = {"kind": "static", "release_nodes": [2], "release_force": [[0.3, 0.0, 2.0]]}

    def make(damping):
        effects = {"weight": {}, "linear_damping": {"b_l": damping}, "quadratic_damping": {"b_q": damping}}
        return chain(length, mass, start, [0.38, 0.0, 0.0], effects)

    return make


@pytest.fixture(scope="module")
def shared():
    """The simulator of the first fit, compiled once."""
    return []


def kicked(scene, change):
    """A film of the rig whose velocities (n, 3) change at an instant, in space."""
    model, start = dj.build(scene)
    stepper = dj.make_stepper(model, "rattle_4", "auto", track_work=False).plain
    step = 1 / (8 * RATE)
    run = jax.jit(lambda s, steps: integrate(stepper, model, s, step, steps, 8), static_argnums=1)
    before, first = run(start, round(8 * RATE * KICK))
    before = getattr(before, "state", before)
    _, second = run(replace(before, v=change(before.v)), round(8 * RATE * (DURATION - KICK)))
    free = np.concatenate([np.asarray(start.r)[None], np.asarray(first.r), np.asarray(second.r)])
    ends = model.ends(0.0)
    nodes = np.asarray(jax.vmap(lambda r: model.nodes(r, ends))(free))
    return observe(Motion(np.arange(len(free)) / RATE, nodes), Camera(angle_noise=0.004), 1, "film")


def out_of_plane(v):
    return v.at[1, 1].add(0.6)


def with_frames_lost(trace):
    """Twelve frames from the kick on are gone, the times of the others closed up."""
    first = round(KICK * RATE)
    gone = np.r_[0:first, first + 12 : len(trace.t)]
    return replace(trace, t=trace.t[: len(gone)], theta=trace.theta[gone])


def with_frames_missing(trace):
    """Twelve frames around the kick have no samples."""
    theta, first = trace.theta.copy(), round(KICK * RATE)
    theta[first - 4 : first + 8] = np.nan
    return replace(trace, theta=theta)


@pytest.mark.check
@pytest.mark.parametrize(
    ("change", "change_trace", "words"),
    [
        (lambda v: v, lambda trace: trace, None),
        (lambda v: 0.3 * v, lambda trace: trace, "kicked or touched at"),
        (out_of_plane, with_frames_missing, "out of its plane, from"),
        (out_of_plane, with_frames_lost, "out of its plane, from"),
    ],
)
def test_a_kick_is_reported_with_its_time_and_its_windows_are_left_out(rig, shared, change, change_trace, words):
    """In the plane or out of it, also with frames missing there."""
    trace = change_trace(kicked(rig(TRUTH), change))
    simulator = shared[0] if shared else None
    prepared = prepare(trace, rig(2 * TRUTH), DAMPING, settings=FitSettings(window=1.5), simulator=simulator)
    shared[:] = [prepared.simulator]
    prepared, names = without_kicks(prepared, estimate)
    prepared = with_sound_windows(prepared)
    at = summarise(prepared, "windows", estimate(prepared, "windows"))
    assert at.solution.status == "ok"
    error = at.uncertainty.std_error
    assert np.all(np.abs(at.values - TRUTH) < 3 * error)
    assert np.all(error < 0.2 * TRUTH)
    if words is None:
        assert not names
        return
    (candidate,) = names
    assert words in candidate.name
    assert float(candidate.name.split(" about ")[1].split()[0]) == pytest.approx(KICK, abs=0.35)
    left = at.solution.windows.begin
    assert left.max() > 9 if "kicked" in words else left.max() < KICK
