"""Public names that were renamed: each old one gives the new thing and one warning, and nothing here uses one."""

import ast
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError, cli
from dropper_jax.base import renamed
from dropper_jax.base.toml_text import jsonable
from dropper_jax.cli import old_names_in_one_line
from dropper_jax.effects import RecordedMotion
from fitting.tracking import Tracked

ROOT = Path(__file__).parents[2]
NAMES = [row for row in renamed.RENAMED if row.kind == "name"]
ATTRIBUTES = [row for row in renamed.RENAMED if row.kind == "attribute"]
MODULES = [row for row in renamed.RENAMED if row.kind == "module"]
KEYS = [row for row in renamed.RENAMED if row.kind == "key"]
OPTIONS = [row for row in renamed.RENAMED if row.kind == "option"]
JSON = [row for row in renamed.RENAMED if row.kind == "json"]
#: Arguments that a command needs next to a renamed option, without its value.
CALLS = {"sweep": ["x", "--out=x.zarr"], "response": ["x", "--periods=1:2:2"], "track": ["x", "--nodes=3"]}


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
    recorded = RecordedMotion(time=np.zeros(2), positions=np.zeros((2, 3)))
    made = (model, model.ends(0.0), model.instant(s.r, s.v, s.t), tracked, recorded)
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


@of(KEYS)
def test_an_old_key_of_a_scene_or_site_is_the_new_one_and_warns(row):
    section, *inner = row.where.split(".")

    def inside(table):
        for name in reversed(inner):
            table = {name: table}
        return table

    with pytest.warns(DeprecationWarning, match=rf"{row.where}.{row.old} is {row.where}.{row.new} since") as warned:
        found = renamed.new_keys({section: [inside({row.old: 1.0, "other": 2.0})] * 2, "name": "x"})
    assert len(warned) == 1
    assert found == {section: [inside({row.new: 1.0, "other": 2.0})] * 2, "name": "x"}
    assert renamed.new_path(f"{row.where}.{row.old}.0") == f"{row.where}.{row.new}.0"
    with pytest.raises(SceneError, match="is the old name of"):
        renamed.new_keys({section: inside({row.old: 1.0, row.new: 1.0})})


@of(OPTIONS)
def test_an_old_option_is_the_new_one_with_one_line_on_standard_error(row, capsys):
    value = [] if row.new in ("--paired", "--no-higher-waves") else ["2.5"]
    with old_names_in_one_line():
        old = vars(cli.parse([row.where, *CALLS[row.where], row.old, *value]))
        new = vars(cli.parse([row.where, *CALLS[row.where], row.new, *value]))
    assert old == new
    out, err = capsys.readouterr()
    assert out == ""
    assert err == f"DeprecationWarning: dropper {row.where} {row.old} is {row.new} since version {row.since}\n"


@of(JSON)
def test_json_has_the_old_and_the_new_name_of_a_scalar(row):
    found = jsonable({"a": [{row.new: np.float64(1.5)}], row.new: [1, 2]})
    assert found == {"a": [{row.new: 1.5, row.old: 1.5}], row.new: [1, 2]}


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
