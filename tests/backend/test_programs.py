"""The bounded store of compiled programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.backend import one_kernel, programs
from dropper_jax.backend.programs import ProgramCache, cached_jit, compile_program
from dropper_jax.cli import main
from dropper_jax.stepping.integrate import growth_meter


@pytest.fixture
def traced():
    """A function compiled through a small store, the shapes it was traced for, and the store."""
    store, shapes = ProgramCache(most=3, cleared_after=1000), []

    @cached_jit(static=("power",), cache=store)
    def raised(x, power=2, shift=0.0):
        shapes.append((x.shape, power))
        return x**power + shift

    return raised, shapes, store


def test_a_kind_is_compiled_once_and_gives_what_jit_gives(traced):
    raised, shapes, _ = traced
    x = jnp.arange(4.0)
    for _ in range(3):
        np.testing.assert_array_equal(raised(x, shift=1.0), x**2 + 1.0)
    np.testing.assert_array_equal(raised(x + 1.0, 2, 1.0), (x + 1.0) ** 2 + 1.0)
    assert shapes == [((4,), 2)]


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(lambda f: f(jnp.ones(5)), id="shape"),
        pytest.param(lambda f: f(jnp.ones(4, jnp.float32)), id="precision"),
        pytest.param(lambda f: f(jnp.ones(4), power=3), id="static argument"),
        pytest.param(lambda f: f(jnp.ones(4), shift=jnp.zeros(4)), id="shape of another"),
    ],
)
def test_another_kind_is_another_program(traced, other):
    raised, shapes, store = traced
    raised(jnp.ones(4))
    other(raised)
    assert (len(shapes), len(store)) == (2, 2)


def test_the_store_holds_at_most_its_number_and_drops_the_one_not_used_for_longest(traced):
    raised, shapes, store = traced
    for size in (1, 2, 3, 1, 4):  # 2 has waited longest when 4 comes
        raised(jnp.ones(size))
    assert len(store) == 3
    for size in (1, 3, 4):
        raised(jnp.ones(size))
    assert len(shapes) == 4
    raised(jnp.ones(2))
    assert [shape for shape, _ in shapes] == [(1,), (2,), (3,), (4,), (2,)]


def test_kept_programs_outlive_the_caches_of_jax(traced):
    raised, shapes, _ = traced
    raised(jnp.ones(4))
    jax.clear_caches()
    np.testing.assert_array_equal(raised(3.0 * jnp.ones(4)), np.full(4, 9.0))
    assert len(shapes) == 1


def test_caches_of_jax_are_emptied_after_the_number_of_new_programs():
    store = ProgramCache(most=3, cleared_after=3)
    double = cached_jit(cache=store)(lambda x: 2.0 * x)
    plain = jax.jit(lambda x: x + 1.0)
    plain(jnp.ones(2))
    for size in (1, 2):
        double(jnp.ones(size))
    assert plain._cache_size() == 1
    double(jnp.ones(3))
    assert plain._cache_size() == 0


def test_it_differentiates_batches_and_nests_as_jit_does(traced):
    raised, _, store = traced
    x = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(jax.grad(lambda x: jnp.sum(raised(x, 3)))(x), 3 * x**2, rtol=1e-15)
    np.testing.assert_array_equal(jax.vmap(raised)(x), x**2)
    np.testing.assert_array_equal(jax.jit(lambda x: raised(x) + raised(x))(x), 2 * x**2)
    assert len(store) == 0  # programs of outer transformations are the caller's


def test_the_program_itself_takes_what_is_not_static(traced):
    raised, shapes, _ = traced
    program = raised.program(jnp.ones(2), 3, jnp.zeros(()))
    np.testing.assert_array_equal(program(jnp.array([2.0, 3.0]), jnp.ones(())), [9.0, 28.0])
    raised(jnp.ones(2), 3, jnp.zeros(()))
    assert len(shapes) == 1


def test_a_compiler_without_an_option_compiles_with_the_others(monkeypatch):
    monkeypatch.setattr(programs, "OPTIONS", {"xla_cpu_is_not_an_option": True, **programs.OPTIONS})
    for kernel in (False, True):
        double = cached_jit(cache=ProgramCache(), kernel=kernel)(lambda x: 2.0 * x)
        assert float(double(jnp.asarray(3.0))) == 6.0


class WithoutOption:
    """A lowered program whose compiler does not know an option; it returns the options that it is compiled with."""

    def compile(self, options):
        for name in sorted(options):
            if name.startswith("removed"):
                raise jax.errors.JaxRuntimeError(f"INVALID_ARGUMENT: No such compile option: '{name}'")
            if name.startswith("failing"):
                raise jax.errors.JaxRuntimeError("UNIMPLEMENTED: Fusion kind not implemented on CPU")
        return options


def test_options_that_a_compiler_knows_are_kept():
    given = {"removed_1": True, "known": 2, "removed_2": False}
    assert programs.compile_lowered(WithoutOption(), given) == {"known": 2}
    with pytest.raises(jax.errors.JaxRuntimeError, match="UNIMPLEMENTED"):
        programs.compile_lowered(WithoutOption(), {"failing": 1})


@pytest.mark.parametrize(("count", "inline"), [(512, True), (513, False)])
def test_large_reductions_that_a_compiler_gives_to_a_library_are_not_inline(monkeypatch, count, inline):
    monkeypatch.setattr(one_kernel, "_calls_reductions", lambda: True)
    traced = jax.make_jaxpr(lambda x: jnp.sum(x, axis=1))(jnp.ones((count, 8)))
    assert one_kernel.is_inline(traced.jaxpr) == inline


def test_derivatives_are_not_metered_where_no_cpu_runs_the_warning(monkeypatch):
    monkeypatch.setattr(one_kernel, "_has_cpu", lambda: False)
    assert growth_meter(jnp.ones(3)) is None


@pytest.mark.check
def test_doctor_reports_an_option_that_the_compiler_does_not_know(monkeypatch, capsys):
    monkeypatch.setattr("dropper_jax.study.doctor.OPTIONS", {"xla_cpu_is_not_an_option": True, **programs.OPTIONS})
    main(["doctor", "--repeats", "2"])
    shown = capsys.readouterr().out
    assert "xla_cpu_is_not_an_option UNKNOWN" in shown
    assert all(f"{name} known" in shown for name in programs.OPTIONS)


def test_programs_with_arrays_are_shared_by_their_values():
    """A second fit of the same scene compiles nothing."""

    def program(factor):
        return compile_program(growth_meter, {"factor": factor}, (jnp.ones(3),), lambda x: factor * x, shared=True)

    assert program(np.array([2.0])) is program(np.array([2.0]))
    np.testing.assert_array_equal(program(np.array([3.0]))(jnp.ones(3)), 3.0)
