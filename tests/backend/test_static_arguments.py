"""What a compiled program is found by: static arguments compare by all that they hold, and hold no traced value."""

import ast
import dataclasses
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax.backend.programs import PROGRAMS
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.stepping.stepper import make_scheme
from dropper_jax.study.march import grid_run

ROOT = Path(__file__).parents[2]
MODULES = {
    str(file.relative_to(ROOT)): ast.parse(file.read_text(encoding="utf-8"))
    for package in ("dropper_jax", "fitting")
    for file in sorted((ROOT / package).rglob("*.py"))
}

TWO_RODS = rods([0.6, 0.3], 0.2, 0.05, {"joint_friction": {"dry": 2e-3, "axis": [0.0, 1.0, 0.0]}})
TWO_RODS["run"] = {"dt": 0.01, "duration": 0.1}


def nodes(kind: type) -> Iterator[tuple[str, Any]]:
    for file, tree in MODULES.items():
        yield from ((file, node) for node in ast.walk(tree) if isinstance(node, kind))


def test_no_class_with_an_equality_of_its_own_can_be_a_static_argument():
    for file, node in nodes(ast.ClassDef):
        methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
        assert "__hash__" not in methods, f"{file}: {node.name} has a hash of its own"
        if "__eq__" in methods:  # Python then takes the hash away, unless the dataclass has it made again
            flags = [key.arg for call in node.decorator_list if isinstance(call, ast.Call) for key in call.keywords]
            assert "unsafe_hash" not in flags, f"{file}: {node.name}"


def test_no_field_is_left_out_of_a_comparison():
    left_out = {file for file, node in nodes(ast.keyword) if node.arg in ("compare", "hash")}
    assert left_out == set()


def test_no_cache_is_keyed_by_the_address_of_an_object():
    assert [file for file, node in nodes(ast.Call) if ast.unparse(node.func) == "id"] == []


def hidden(value: Any, where: str) -> Iterator[str]:
    """What a static value holds beside what its comparison sees, and arrays of JAX in it."""
    if isinstance(value, jax.Array):
        yield f"{where}: {type(value).__name__}"
    elif dataclasses.is_dataclass(value):
        fields = {field.name for field in dataclasses.fields(value)}
        derived = {
            name for cls in type(value).__mro__ for name, x in vars(cls).items() if isinstance(x, cached_property)
        }
        yield from (f"{where}.{name}: not compared" for name in vars(value).keys() - fields - derived)
        for name, part in vars(value).items():
            yield from hidden(part, f"{where}.{name}")
    elif isinstance(value, (tuple, list, frozenset)):
        for i, part in enumerate(value):
            yield from hidden(part, f"{where}[{i}]")
    elif isinstance(value, dict):
        for name, part in value.items():
            yield from hidden(part, f"{where}[{name!r}]")


def static_parts(tree: jax.tree_util.PyTreeDef) -> Iterator[Any]:
    """Static data of a tree's types."""
    if tree.node_data() is not None:
        yield tree.node_data()[1]
    for branch in tree.children():
        yield from static_parts(branch)


@pytest.fixture(scope="module")
def friction():
    """Two rods with dry joints after a plain run, whose step has been traced for `energy_momentum`."""
    model, s = dj.build(TWO_RODS)
    PROGRAMS.clear()
    plain = dj.integrate(dj.make_stepper(model), model, s, 0.01, 4, 4)[0].r
    return model, s, plain


def test_schemes_that_share_a_program_have_their_own_numbers_after_another_run(friction):
    """A weight written into a static scheme gave those of `energy_momentum`, or a tracer of another program."""
    model, s, plain = friction
    ends = {}
    for integrator, gamma in (("energy_momentum", None), ("theta_midpoint", 0.9), ("theta_midpoint", 0.7)):
        stepper = dj.make_stepper(model, integrator, gamma=gamma)
        ends[gamma] = grid_run(stepper, model, s, 0.04, 4, 1).r[0]
    np.testing.assert_allclose(ends[None], plain, atol=1e-12)
    own = dj.make_stepper(model, "theta_midpoint", gamma=0.9)
    np.testing.assert_allclose(ends[0.9], dj.integrate(own, model, s, 0.01, 4, 4)[0].r, atol=1e-12)
    assert np.abs(ends[0.9] - ends[0.7]).max() > 1e-6


def test_a_step_is_chosen_with_dry_friction_before_anything_else_has_run():
    """The choice of the step runs the program that schemes share, and a run then takes a step of its own."""
    PROGRAMS.clear()
    jax.clear_caches()
    found = dj.simulate(TWO_RODS, tolerance=0.05)
    assert found.status == "ok"


def test_static_arguments_of_all_programs_hold_nothing_that_their_comparison_does_not_see(friction):
    keys = list(PROGRAMS._programs)
    assert len(keys) >= 2
    found = []
    for function, settings, tree, *_ in keys:
        for name, value in settings:
            found += hidden(value, f"{function.__name__}({name})")
        for part in static_parts(tree):
            found += hidden(part, f"{function.__name__}(...)")
    assert found == []


@pytest.mark.parametrize("name", INTEGRATORS)
def test_schemes_compare_by_all_their_numbers(name):
    scheme = make_scheme(name, {})
    assert scheme == make_scheme(name, {})
    assert set(vars(scheme)) == set(scheme.options())
    for option, about in scheme.options().items():
        other = make_scheme(name, {option: about["high"]})
        assert (other == scheme) == (getattr(scheme, option) == about["high"])
