"""Faults at an instant: a jump of known frames, samples of their own in smooth misfits, kicks of a simulated rig."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import integrate
from fitting import Camera, FitSettings, Motion, observe, prepare
from fitting.calibration.estimating import estimate
from fitting.calibration.kicks import without_kicks
from fitting.calibration.lost_frames import alone, best_jump
from fitting.calibration.lost_windows import with_sound_windows
from fitting.calibration.summarise import summarise


def swinging(count):
    t = np.arange(count) / 60
    return np.stack([0.8 * np.sin(7.1 * t), 0.5 * np.sin(9.3 * t + 1) + 0.2 * np.sin(21 * t)], axis=1)


@pytest.mark.parametrize(("frames", "at"), [(12, 90), (1, 100), (-3, 75), (30, 95)])
def test_a_jump_along_the_flow_is_found_where_it_is(frames, at):
    angle = swinging(180)
    rng = np.random.default_rng(at)
    index = np.arange(140) + np.where(np.arange(140) >= at, frames, 0)
    measured = angle[index] + 0.004 * rng.standard_normal((140, 2))
    measured[20, 0] += 0.3
    gain, first, lag = best_jump(angle[:140], measured, np.full((140, 2), 250.0), 60)
    assert (first, lag) == (at, frames)
    assert gain > 100
    whole = angle[:140] + 0.004 * rng.standard_normal((140, 2))
    assert best_jump(angle[:140], whole, np.full((140, 2), 250.0), 60)[0] < 5


def test_samples_that_stand_out_alone_are_counted_and_smooth_misfits_are_not():
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((6, 80, 2)) + 20 * np.sin(np.arange(80) / 12)[None, :, None]
    solution = SimpleNamespace(errors=errors, windows=SimpleNamespace(weight=np.ones_like(errors), jitter=None))
    assert alone(solution) == 0
    for k, s, j in ((0, 10, 0), (3, 50, 1), (5, 40, 0), (5, 60, 1)):
        errors[k, s, j] += 25
    assert alone(solution) == 4


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
    ("change", "spoil", "words"),
    [
        (lambda v: v, lambda trace: trace, None),
        (lambda v: 0.3 * v, lambda trace: trace, "kicked or touched at"),
        (out_of_plane, with_frames_missing, "out of its plane, from"),
        (out_of_plane, with_frames_lost, "out of its plane, from"),
    ],
)
def test_a_kick_is_named_with_its_time_and_what_it_spoils_is_left_out(rig, shared, change, spoil, words):
    """In the plane or out of it, frames missing there: before, such a fit was `ok` with chi-square 2000 and no name."""
    trace = spoil(kicked(rig(TRUTH), change))
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
