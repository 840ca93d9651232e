"""Public names that were renamed: each old one gives the new thing and one warning, and nothing here uses one."""

import ast
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.base import renamed
from fitting.tracking import Tracked

ROOT = Path(__file__).parents[2]
NAMES = [row for row in renamed.RENAMED if row.kind == "name"]
ATTRIBUTES = [row for row in renamed.RENAMED if row.kind == "attribute"]
MODULES = [row for row in renamed.RENAMED if row.kind == "module"]


def of(rows):
    return pytest.mark.parametrize("row", rows, ids=[f"{row.where}.{row.old}" for row in rows])


@pytest.fixture(autouse=True)
def nothing_warned(monkeypatch):
    monkeypatch.setattr(renamed, "_WARNED", set())


@pytest.fixture(scope="module")
def things():
    """One of each class that had other attributes, by its name."""
    model, s = dj.build("conical-pendulum")
    tracked = object.__new__(Tracked)
    for name in ("detected", "appearance"):
        object.__setattr__(tracked, name, np.zeros(2))
    made = (model, model.ends(0.0), model.instant(s.r, s.v, s.t), tracked)
    return {f"{type(thing).__module__}.{type(thing).__qualname__}": thing for thing in made}


@of(NAMES)
def test_an_old_name_of_a_module_is_the_new_one_and_warns_once(row):
    module = importlib.import_module(row.where)
    with pytest.warns(DeprecationWarning, match=rf"{row.old} is .*{row.new} since") as warned:
        old = getattr(module, row.old)
    assert getattr(module, row.old) is old  # without a warning, which would be an error here
    assert len(warned) == 1
    assert warned[0].filename == __file__
    assert old is getattr(module, row.new)


@of(ATTRIBUTES)
def test_an_old_attribute_is_the_new_one_and_warns_once(row, things):
    thing = things[row.where]
    with pytest.warns(DeprecationWarning, match=rf"{row.old} is .*{row.new} since") as warned:
        old = getattr(thing, row.old)
    assert len(warned) == 1
    assert warned[0].filename == __file__
    new = getattr(thing, row.new)
    assert old is new or old == new  # bound methods are made anew


@of(MODULES)
def test_an_old_module_is_the_new_one_and_warns(row, monkeypatch):
    old = f"{row.where}.{row.old}"
    monkeypatch.delitem(sys.modules, old, raising=False)
    with pytest.warns(DeprecationWarning, match=rf"{old} is .*{row.new} since"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(row.path)
    assert module.__name__ == module.__spec__.name == row.path


def test_what_has_no_such_name_says_so_as_before(things):
    with pytest.raises(AttributeError, match="module 'dropper_jax' has no attribute 'nothing'"):
        dj.nothing  # noqa: B018
    for thing in things.values():
        with pytest.raises(AttributeError, match=f"'{type(thing).__name__}' object has no attribute 'nothing'"):
            thing.nothing  # noqa: B018


def test_the_packages_themselves_import_no_old_name():
    old = {(row.where, row.old) for row in renamed.RENAMED}
    for folder in ("dropper_jax", "fitting"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    used = {(node.module, alias.name) for alias in node.names}
                    used.add(tuple(node.module.rpartition(".")[::2]))
                    assert not used & old, (path, node.lineno)
