"""Traces kept from one process to the next: found again for the same program only, and made again where damaged."""

import json
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.backend import export_cache
from dropper_jax.backend.compile_cache import Entries
from dropper_jax.backend.export_cache import PREFIX, Constants, Traces
from dropper_jax.base.numerics import components, inverse_rows
from dropper_jax.base.plain_form import NoPlainForm, read, to_plain, tree_read, tree_written
from dropper_jax.stepping.integrate import advance_some, begin

MATRICES = jnp.asarray(np.random.default_rng(1).normal(size=(4, 3, 3)) + 3.0 * np.eye(3))


@pytest.fixture(autouse=True)
def sources(monkeypatch):
    """Sources that stay as they are, whoever edits them while these tests run."""
    monkeypatch.setattr(export_cache, "_sources_digest", lambda: "as they are")


class Counted:
    """A function that counts how often it is traced."""

    def __init__(self, function):
        self.function, self.traced = function, 0

    def __call__(self, *values):
        self.traced += 1
        return self.function(*values)


def answer(folder, one, function=inverse_rows, settings=None, values=(MATRICES,)):
    """What a process that starts now computes: a new store over the same folder."""
    lowered = Traces(Entries(folder)).lower(function, settings or {}, values, one) or jax.jit(one).lower(*values)
    return lowered.compile()(*values)


def files(folder):
    return sorted(file.name for file in folder.iterdir())


def test_a_second_process_does_not_trace_and_gets_the_same_numbers_in_the_same_tree(tmp_path):
    first, second = Counted(inverse_rows), Counted(inverse_rows)
    a, b = answer(tmp_path, first), answer(tmp_path, second)
    assert (first.traced, second.traced) == (1, 0)
    assert [name[: len(PREFIX)] for name in files(tmp_path)] == [PREFIX]
    assert jax.tree.structure(a) == jax.tree.structure(b)
    inverse = np.linalg.inv(MATRICES)
    found = np.stack([np.stack(row, axis=-1) for row in b], axis=-2)
    np.testing.assert_allclose(found, inverse, rtol=1e-12)


def test_a_run_goes_on_from_a_trace_to_the_same_bits(tmp_path):
    scene = dj.load_scene("conical-pendulum")
    model, s = dj.build(scene)
    stepper = dj.make_stepper(model).plain
    settings = {"stepper": stepper, "capacity": 8, "save_every": 2}
    values = model, begin(stepper, model, s), jnp.asarray(0.01), jnp.asarray(5, jnp.int32)
    run = lambda model, progress, dt, count: advance_some(  # noqa: E731
        stepper, model, progress, dt, count, capacity=8, save_every=2
    )
    first, second = Counted(run), Counted(run)
    a, b = (answer(tmp_path, one, advance_some, settings, values) for one in (first, second))
    assert (first.traced, second.traced) == (1, 0)
    expected = jax.jit(run)(*values)
    assert jax.tree.structure(a) == jax.tree.structure(b) == jax.tree.structure(expected)
    for got, again, meant in zip(*map(jax.tree.leaves, (a, b, expected)), strict=True):
        np.testing.assert_array_equal(got, again)
        np.testing.assert_allclose(got, meant, rtol=1e-12, atol=1e-12)
        assert got.dtype == meant.dtype
    assert float(np.abs(b[1].v[4]).max()) > 0.1  # it moves


OTHERS = [
    pytest.param(lambda patch: {"values": (MATRICES[:2],)}, id="shape"),
    pytest.param(lambda patch: {"values": (MATRICES.astype(jnp.float32),)}, id="precision"),
    pytest.param(lambda patch: {"values": ([MATRICES],)}, id="tree"),
    pytest.param(lambda patch: {"settings": {"capacity": 3}}, id="static argument"),
    pytest.param(lambda patch: {"settings": {"capacity": 3.0}}, id="kind of static argument"),
    pytest.param(lambda patch: {"function": components}, id="function"),
    pytest.param(lambda patch: patch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false"), id="flags"),
    pytest.param(lambda patch: patch.setattr(jax, "__version__", "9.9.9"), id="JAX"),
    pytest.param(lambda patch: patch.setattr(export_cache, "_sources_digest", lambda: "0"), id="sources"),
]


@pytest.mark.parametrize("other", OTHERS)
def test_another_program_is_another_trace(tmp_path, monkeypatch, other):
    answer(tmp_path, inverse_rows)
    given = other(monkeypatch) or {}
    one = Counted(lambda x: inverse_rows(jax.tree.leaves(x)[0]))
    answer(tmp_path, one, **given)
    assert one.traced == 1
    assert len(files(tmp_path)) == 2


def test_another_setting_of_jax_is_another_trace(tmp_path):
    answer(tmp_path, inverse_rows)
    one = Counted(inverse_rows)
    with jax.default_matmul_precision("float32"):
        answer(tmp_path, one)
    assert one.traced == 1


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda whole, other: whole[: len(whole) // 2], id="half of it"),
        pytest.param(lambda whole, other: b"", id="nothing"),
        pytest.param(lambda whole, other: whole[:-1] + b"x", id="another byte"),
        pytest.param(lambda whole, other: other, id="the trace of another program"),
    ],
)
def test_what_is_damaged_or_belongs_to_another_is_made_again(tmp_path, spoil):
    expected = answer(tmp_path, inverse_rows)
    (name,) = files(tmp_path)
    beside = tmp_path / "beside"
    beside.mkdir()
    answer(beside, inverse_rows, values=(MATRICES[:2],))
    (other,) = files(beside)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(spoil(whole, (beside / other).read_bytes()))
    for times in (1, 0):
        one = Counted(inverse_rows)
        np.testing.assert_array_equal(answer(tmp_path, one), expected)
        assert one.traced == times


def test_a_head_that_says_something_else_is_made_again(tmp_path):
    expected = answer(tmp_path, inverse_rows)
    (name,) = files(tmp_path)
    entries = Entries(tmp_path)
    head, _, module = entries.get(name).partition(b"\n")
    said = json.loads(head)
    other = json.dumps(said | {"tree": ["node", "os:system", None]}).encode()
    for broken, beside in ((b"{}", module), (b"\xff", module), (other, module), (head, b"no module"), (head, b"")):
        entries.put(name, broken + b"\n" + beside)
        one = Counted(inverse_rows)
        np.testing.assert_array_equal(answer(tmp_path, one), expected)
        assert one.traced == 1
        assert json.loads(entries.get(name).partition(b"\n")[0]) == said


def test_sources_that_change_as_a_process_runs_leave_no_trace(tmp_path, monkeypatch):
    digests = iter(["before", "after"])
    monkeypatch.setattr(export_cache, "_sources_digest", lambda: next(digests))
    answer(tmp_path, inverse_rows)
    assert files(tmp_path) == []


@dataclass(frozen=True)
class Foreign:
    size: float = 1.0


@pytest.mark.parametrize("value", [lambda x: x, Foreign(), np.array(["a"]), object(), Foreign, print, 1j])
def test_what_another_process_may_take_for_something_else_is_refused(tmp_path, value):
    with pytest.raises(NoPlainForm):
        to_plain(value)
    one = Counted(inverse_rows)
    answer(tmp_path, one, settings={"capacity": value})
    assert one.traced == 1  # as ever
    assert files(tmp_path) == []


def test_arrays_that_a_program_holds_are_part_of_what_it_is_known_by(tmp_path):
    for held, traced in ((MATRICES, 1), (MATRICES, 0), (MATRICES.at[0, 0, 0].add(1e-15), 1), ([MATRICES], 1)):
        one = Counted(lambda x, held=held: inverse_rows(x + jax.tree.leaves(held)[0]))
        found = answer(tmp_path, one, settings={"model": Constants(held)})
        assert one.traced == traced
        expected = inverse_rows(MATRICES + jax.tree.leaves(held)[0])
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)


def test_a_program_that_prints_is_not_kept(tmp_path):
    def speaks(x):
        jax.debug.print("{}", x[0, 0, 0])
        return inverse_rows(x)

    answer(tmp_path, speaks)
    assert files(tmp_path) == []


@pytest.mark.parametrize("name", ["dropper-release-a", "edulis-longline", "dropper-farm-10", "paper-case-1"])
def test_models_and_steppers_are_read_as_they_were_written(name):
    scene = dj.load_scene(name)
    model = build_model(scene)
    tree, stepper = jax.tree.structure((model, {"a": [1, None]})), dj.make_stepper(model)
    assert tree_read(json.loads(json.dumps(tree_written(tree)))) == tree
    assert read(json.loads(json.dumps(to_plain(stepper)))) == stepper
    assert tree_written(tree) != tree_written(jax.tree.structure((model, {"b": [1, None]})))


def test_the_digest_of_the_sources_is_that_of_all_files(tmp_path, monkeypatch):
    for name in ("dropper_jax/a.py", "dropper_jax/b/c.py", "fitting/d.py", "other/e.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\n")
    monkeypatch.undo()  # the fixture's
    digest = lambda: export_cache._sources_digest(tmp_path)  # noqa: E731
    first = digest()
    (tmp_path / "other/e.py").write_text("x = 2\n")
    assert digest() == first
    for name in ("dropper_jax/b/c.py", "fitting/d.py"):
        (tmp_path / name).write_text("x = 2\n")
        assert digest() != first
        (tmp_path / name).write_text("x = 1\n")
        assert digest() == first
    (tmp_path / "dropper_jax/b/c.py").rename(tmp_path / "dropper_jax/c.py")
    assert digest() != first


def test_arrays_among_settings_are_read_as_they_were_written():
    array = np.linspace(0.0, 1.0, 6).reshape(2, 3)
    again = read(json.loads(json.dumps(to_plain(array))))
    np.testing.assert_array_equal(again, array)
    assert again.dtype == array.dtype
    assert to_plain(array) != to_plain(array.T)
