"""Random scenes: valid ones run to an honest end, invalid ones are refused in one line.

20 examples each by default; `make fuzz` and `make check` set FUZZ_EXAMPLES. Shapes and effects come from a handful of
templates, so that few programs are compiled; everything else is drawn.
"""

import copy
import math
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dropper_jax import SceneError, build, load_scene, make_stepper
from dropper_jax.study.march import grid_run

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "20"))
#: The default examples are the same in every run; further ones are drawn at random.
FUZZ = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=EXAMPLES <= 20,
    database=None,
    suppress_health_check=list(HealthCheck),
)
STEPS = 24
FAILURES = ("not_converged", "non_finite", "retry_exhausted")
#: Energy that may appear from nowhere, over the scale of the motion: steps are solved to 1e-11.
RISE = 1e-7


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers spread evenly over decades."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda x: 10.0**x)


def per_link(links: int, low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.lists(decades(low, high), min_size=links, max_size=links)


EFFECTS = st.fixed_dictionaries(
    {
        "weight": st.fixed_dictionaries({"gravity": st.floats(0.5, 30.0)}),
        "linear_damping": st.fixed_dictionaries({"b_l": st.one_of(st.just(0.0), decades(1e-5, 1e3))}),
        "quadratic_damping": st.fixed_dictionaries({"b_q": st.one_of(st.just(0.0), decades(1e-5, 1e3))}),
    }
)


@st.composite
def loops(draw: st.DrawFn, links: int = 5) -> dict:
    """A loop between two fixed points, released from a random force."""
    lengths = draw(per_link(links, 0.05, 2.0))
    masses = draw(per_link(links, 1e-2, 10.0))
    total, longest = sum(lengths), max(lengths)
    # between what the longest link needs to close and the straight line
    least = max(0.0, 2 * longest - total)
    width = least + draw(st.floats(0.02, 0.98)) * (total - least)
    rise = draw(st.floats(-0.3, 0.3))
    pull = [draw(st.floats(-2.0, 2.0)) * sum(masses) for _ in range(3)]
    return {
        "run": {"dt": draw(decades(1e-4, 0.3)), "duration": 1000.0},
        "point": [
            {"name": "left", "position": [0.0, 0.0, 0.0]},
            {"name": "right", "position": [width * math.cos(rise), 0.0, width * math.sin(rise)]},
        ],
        "line": [{"name": "line", "from": "left", "to": "right", "links": links, "length": lengths, "mass": masses}],
        "effects": draw(EFFECTS),
        "start": {"kind": "static", "release_nodes": [draw(st.integers(1, links - 1))], "release_force": [pull]},
    }


@st.composite
def chains(draw: st.DrawFn, links: int = 3) -> dict:
    """A chain with a free end, thrown from random angles."""
    lengths = draw(per_link(links, 0.05, 2.0))
    angle = st.floats(-math.pi, math.pi)
    rate = st.floats(-5.0, 5.0)
    several = lambda one: draw(st.lists(one, min_size=links, max_size=links))  # noqa: E731
    return {
        "run": {"dt": draw(decades(1e-4, 0.3)), "duration": 1000.0},
        "point": [
            {"name": "pivot", "position": [0.0, 0.0, 0.0]},
            {"name": "tip", "kind": "free", "position": [0.0, 0.0, 0.0]},
        ],
        "line": [
            {"name": "line", "from": "pivot", "to": "tip", "links": links, "length": lengths}
            | {"mass": draw(per_link(links, 1e-3, 100.0))}
        ],
        "effects": draw(EFFECTS),
        "start": {
            "kind": "angles",
            "zero": "down",
            "polar": several(angle),
            "azimuth": several(angle),
            "polar_rate": several(rate),
            "azimuth_rate": several(rate),
        },
    }


@pytest.mark.slow
@FUZZ
@given(st.one_of(loops(), chains()))
def test_a_valid_scene_runs_to_an_honest_end(table: dict) -> None:
    """Finite with status ok and a residual below tolerance, or a named failure; no energy from nowhere."""
    scene = load_scene(table)
    try:
        model, s = build(scene)
    except SceneError:  # a pose that was not found is a named failure too
        return
    stepper = make_stepper(model, halvings=3)
    dt = scene.run.step
    found = grid_run(stepper, model, s, dt, 1, STEPS)
    run = found.rows
    if found.status != "ok":
        assert found.status in FAILURES
        assert int(run.bad[-1]) >= 0
        return
    assert all(np.all(np.isfinite(x)) for x in (run.r, run.v, run.tension, run.work))
    assert float(run.residual[-1]) <= stepper.limit(model)
    drift = np.max(np.abs(found.energy_loss))
    mass = np.asarray(model.line.mass)[: model.free_nodes]
    speeds = np.concatenate([np.asarray(s.v)[None], run.v])
    kinetic = 0.5 * np.sum(mass[None, :, None] * speeds**2, axis=(1, 2)).max()
    weight = scene.effects["weight"]["gravity"] * np.sum(mass) * np.sum(model.line.length)
    scale = kinetic + weight + np.max(np.abs(run.work), initial=0.0)
    assert drift <= RISE * scale
    damped = np.sum(run.work, axis=1)
    assert np.all(np.diff(np.concatenate([[0.0], damped])) <= RISE * scale)


BAD_NUMBERS = st.sampled_from([float("nan"), float("inf"), -float("inf"), -1.0, "two", None, True, [], {}, [1.0, 2.0]])
NOT_POSITIVE = st.one_of(BAD_NUMBERS, st.just(0.0), st.floats(max_value=0.0))
PATHS = {
    ("run", "dt"): NOT_POSITIVE,
    ("run", "duration"): NOT_POSITIVE,
    ("run", "integrator"): st.sampled_from([3, "", None, []]),
    ("run", "dtype"): st.text(max_size=5),
    ("line", 0, "length"): NOT_POSITIVE,
    ("line", 0, "mass"): NOT_POSITIVE,
    ("line", 0, "links"): st.sampled_from([0, -1, 1.5, "5", None, True]),
    ("line", 0, "to"): st.text(max_size=5),
    ("line", 0, "unknown"): st.integers(),
    ("effects", "linear_damping"): st.sampled_from([{"b_l": -1.0}, {"b_l": float("nan")}, {}, 3, {"bl": 1.0}]),
    ("effects", "weight"): st.sampled_from([{"gravity": -1.0}, [], {"wet_weight": "heavy"}]),
    ("effects", "wind"): st.just({}),
    ("point", 0, "position"): st.sampled_from([[0.0], [0.0, 0.0, float("nan")], "here", None, [0, 0, [0]]]),
    ("point", 0, "name"): st.sampled_from([3, None, "elsewhere"]),
    ("point", 1, "position"): st.just([1e6, 0.0, 0.0]),
    ("start", "kind"): st.text(max_size=5),
    ("start", "release_nodes"): st.sampled_from([[0], [99], ["one"], [1, 2], -1]),
    ("nonsense",): st.integers(),
}


@st.composite
def invalid_scenes(draw: st.DrawFn) -> dict:
    *parents, key = draw(st.sampled_from(sorted(PATHS, key=str)))
    value = draw(PATHS[(*parents, key)])
    table = owner = copy.deepcopy(draw(loops()))
    for parent in parents:
        owner = owner[parent]
    owner[key] = value
    return table


@FUZZ
@given(invalid_scenes())
def test_an_invalid_scene_is_refused_in_one_line(table: dict) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(table)
    text = str(caught.value)
    assert text
    assert "\n" not in text
