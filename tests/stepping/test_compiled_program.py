"""What a scene lacks is not in its program: operations of one step's jaxpr, counted with all their inner programs.

`golden/operations.json` holds the operations that compute: those of a step under weight alone, those that each effect
adds, and how many each scene's step has, as a bound on its growth. After an intended change of a step, write it again:

    python tests/stepping/test_compiled_program.py
"""

import json
from collections import Counter
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest
from hard_scenes import SINGLE_LINES

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.effects import EFFECTS

GOLDEN = Path(__file__).parents[1] / "golden" / "operations.json"
#: The scene that all others are measured by: weight alone, on inextensible links.
REFERENCE = "string"
#: Operations that move numbers or wrap others. They depend on JAX's version and on shapes, not on what is computed.
MOVING = {"broadcast_in_dim", "concatenate", "convert_element_type", "copy", "custom_jvp_call", "dynamic_slice"}
MOVING |= {"dynamic_update_slice", "gather", "iota", "jit", "pad", "pjit", "reshape", "rev", "slice", "split"}
MOVING |= {"squeeze", "stack", "stop_gradient", "transpose"}
#: Functions that a still, dry scene has no use for; sqrt belongs to |v| of quadratic damping.
TRANSCENDENTAL = {"sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "exp2", "log", "log1p", "atan2", "pow", "erf"}


def step_jaxpr(source, **choice):
    model = build_model(dj.load_scene(source))
    s = dj.state(model, jnp.zeros((model.free_nodes, 3)))  # its shapes count, not where it is
    stepper = dj.make_stepper(model, **choice)
    return jax.make_jaxpr(partial(dj.step, stepper))(model, s, jnp.asarray(0.005))


def inner(value):
    """Programs inside a parameter of an operation."""
    if hasattr(value, "eqns"):
        return [value]
    if hasattr(value, "jaxpr"):
        return [value.jaxpr]
    return [p for item in value for p in inner(item)] if isinstance(value, list | tuple) else []


def count(program):
    """Operations of a jaxpr by name, those of its inner programs included."""
    found = Counter()
    for equation in program.eqns:
        found[equation.primitive.name] += 1
        for value in equation.params.values():
            for part in inner(value):
                found += count(part)
    return found


def operations(source, **choice):
    return count(step_jaxpr(source, **choice).jaxpr)


@pytest.fixture(scope="module")
def golden():
    return json.loads(GOLDEN.read_text())


@pytest.fixture(scope="module")
def counts():
    """Operations of the packaged scenes' steps by name."""
    return {name: operations(name) for name in SINGLE_LINES}


def computing(found):
    return set(found) - MOVING


@pytest.mark.parametrize("name", SINGLE_LINES)
def test_step_of_a_packaged_scene_has_the_operations_of_its_effects_and_no_others(name, golden, counts):
    effects = dj.load_scene(name).to_dict()["effects"]
    added = {effect: set(golden["effects"][effect]) for effect in effects}
    found = computing(counts[name])
    assert found - set(golden["step"]).union(*added.values()) == set()
    assert {effect: missing for effect in effects if (missing := added[effect] - found)} == {}


@pytest.mark.parametrize("name", SINGLE_LINES)
def test_step_of_a_packaged_scene_grows_by_no_tenth(name, golden, counts):
    """Another version of JAX traces the same code to up to 40 % more, but all scenes alike."""
    stored = golden["counts"]
    same = jax.__version__ == golden["jax"]
    assert counts[name].total() == pytest.approx(stored[name], rel=0.1 if same else 0.4)
    ratio = counts[name].total() / counts[REFERENCE].total()
    assert ratio == pytest.approx(stored[name] / stored[REFERENCE], rel=0.1)


UNDAMPED = ["conical-pendulum", "string", "dropper-release-3d-undamped", "dropper-release-a-compound-undamped"]


@pytest.mark.parametrize("name", UNDAMPED)
def test_scenes_without_water_and_drag_have_no_transcendental_functions(name):
    assert not TRANSCENDENTAL & set(operations(name))


def test_drag_brings_the_one_function_of_its_weight():
    assert TRANSCENDENTAL & set(operations("dropper-release-3d")) == {"tanh"}


def test_a_harmonic_end_brings_its_sine_and_nothing_else_does():
    values = {"point": "right", "amplitude": [0.01, 0.0, 0.0], "period": 2.0}
    moved = {f"effects.end_motion.{key}": value for key, value in values.items()}
    assert "sin" in operations(dj.load_scene("dropper-release-a").with_values(moved))
    assert "sin" not in operations("dropper-release-a")


def without(name, *gone):
    table = dj.load_scene(name).to_dict()
    table["effects"] = {key: value for key, value in table["effects"].items() if key not in gone}
    return table


def test_each_effect_adds_operations_of_its_own():
    everything = operations("dropper-release-a").total()
    for gone in ("linear_damping", "quadratic_damping"):
        assert operations(without("dropper-release-a", gone)).total() < everything
    assert "sqrt" not in operations(without("dropper-release-a", "quadratic_damping"))


def in_water(**changed):
    return {**dj.load_scene("wet-pendulum-wave").to_dict(), **changed}


def test_water_costs_nothing_where_no_effect_feels_it():
    effects = {"weight": {}, "linear_damping": {"b_l": 0.1}}
    wet = in_water(effects=effects)
    dry = {key: value for key, value in wet.items() if key != "sea"}
    found = [operations(scene) for scene in (dry, wet)]
    for counts in found:
        del counts["stop_gradient"]  # one for each array of the model; it computes nothing
    assert found[0] == found[1]
    assert not {"exp", "cos", "sin", "cosh"} & set(found[0])


def test_a_scene_with_only_a_current_has_no_wave_functions():
    assert not {"exp", "cosh", "sinh"} & set(operations(in_water(sea={"depth": 20.0, "current": {"speed": 1.0}})))
    assert {"exp", "sin"} <= set(operations(in_water()))


def test_work_that_nobody_asks_for_is_not_computed():
    assert operations("dropper-release-a", track_work=False).total() <= operations("dropper-release-a").total()


def added_by(effect, name):
    """What a scene's step computes with this effect and not under weight alone."""
    return computing(operations(without(name, *EFFECTS.keys() - {effect, "weight"}))) - computing(BARE)


if __name__ == "__main__":
    WEIGHT_ALONE = ("conical-pendulum", "string", "dropper-release-a-undamped", "dropper-release-a-compound-undamped")
    BARE = sum((operations(name) for name in WEIGHT_ALONE), Counter())
    EXAMPLES = dict.fromkeys(("linear_damping", "quadratic_damping", "nodal_force"), "dropper-release-3d")
    found = {
        "jax": jax.__version__,
        "step": sorted(computing(BARE)),
        "effects": {"weight": [], **{effect: sorted(added_by(effect, name)) for effect, name in EXAMPLES.items()}},
        "counts": {name: operations(name).total() for name in SINGLE_LINES},
    }
    GOLDEN.write_text(json.dumps(found, indent=1) + "\n")
