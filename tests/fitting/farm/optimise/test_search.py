"""The search's bookkeeping on problems whose numbers are written down: residuals, parallel runs."""

import dataclasses
import threading
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.base.progress import silent
from dropper_jax.study.gradient_check import GradientCheck
from fitting.farm.optimise import along_gradient
from fitting.farm.optimise.optimum import Optimum, design_warnings
from fitting.farm.optimise.search import measure_design, run_search
from fitting.farm.optimise.search_file import digest_inputs
from fitting.farm.optimise.search_round import MAX_RESIDUAL, run_round
from fitting.farm.optimise.search_state import Search
from fitting.farm.optimise.values import Values, dominated_slopes
from fitting.farm.site import read_site, site_text

#: Two runs that show what the gradient predicts.
TRUE_GRADIENT = GradientCheck.of(1.0, 1.0)


def values(*constraints):
    count = len(constraints)
    return Values(2.0, np.zeros(1), tuple("abc"[:count]), np.array(constraints), np.zeros((count, 1)))


def test_the_residual_is_that_of_windows_before_they_are_renewed():
    design = SimpleNamespace(measure=lambda x, say: ((), values(0.90, 0.50)))
    search = Search(np.zeros(1), 0.1)
    measure_design(search, design, None)
    assert (search.residual, search.best_residual) == (None, None)
    search.best_objective = np.inf
    measure_design(search, design, None, predicted=values(0.87, 0.51))
    assert [search.residual, search.best_residual, search.history[-1]["residual"]] == pytest.approx([0.03] * 3)


def test_large_residuals_and_designs_that_are_no_optimum_are_reported():
    assert design_warnings(MAX_RESIDUAL, 0.95, 0.01, (), TRUE_GRADIENT) == []
    assert design_warnings(float("nan"), 1.0, 0.2, (), TRUE_GRADIENT) == []
    for numbers, words in (
        ((0.03, 1.0, 0.2), "differed by 3.0% of a limit"),
        ((0.0, 0.4, 0.2), "balance 40% of the objective's slope"),
        ((0.0, 1.0, 0.004), "changes of up to 0.40% of the variables' ranges"),
    ):
        (line,) = design_warnings(*numbers, (), TRUE_GRADIENT)
        assert words in line


@pytest.mark.parametrize(("objective", "gain"), [((4.0, 3.0), 0.25), ((0.0, 0.0), np.nan)])
def test_the_gain_is_relative_and_unknown_where_the_start_costs_nothing(objective, gain):
    np.testing.assert_equal(Optimum.gain.fget(SimpleNamespace(objective=objective)), gain)


def test_a_derivative_that_one_snapping_seed_dominates_is_reported_by_mean_and_median():
    # ten seeds of a farm's leg tension, by the leg's length and its diameter
    length = [-723.0, -467.0, -438.0, -383.0, -293.0, -238.0, -233.0, -159.0, -129.0, 1282.0]
    diameter = [10.0, 12.0, 14.0, 14.0, 15.0, 15.0, 15.0, 16.0, 17.0, 44.0]
    rows = np.array([length, diameter]).T
    own = Values(1.0, np.zeros(2), ("legs", "backbone"), np.array([0.98, 0.5]), np.zeros((2, 2)))
    own = dataclasses.replace(own, by_seed={"legs": rows, "backbone": rows})
    (found,) = dominated_slopes(own, np.ones(2), 0.99)
    assert (found.constraint, found.variable, found.seed) == ("legs", 0, 9)
    assert (found.mean, found.median) == pytest.approx((-178.1, -265.5))
    assert "one seed dominates 1 derivative" in design_warnings(0.0, 1.0, 0.2, [found], TRUE_GRADIENT)[0]
    assert dominated_slopes(dataclasses.replace(own, by_seed={"legs": rows[:9]}), np.ones(2), 0.99) == []
    assert dominated_slopes(dataclasses.replace(own, by_seed={"legs": rows[8:]}), np.ones(2), 0.99) == []


@pytest.mark.parametrize(("slope", "status"), [(3.0, "trusted"), (3e5, "not_trusted"), (np.nan, "not_trusted")])
def test_two_runs_along_the_gradient_show_whether_it_predicts_the_highest_peak(monkeypatch, slope, status):
    peaks = lambda x: np.array([1.0, 3.0 * x[0]])  # noqa: E731
    storm_runs = SimpleNamespace(
        run_window=lambda x, own: SimpleNamespace(hard=peaks(x), soft=peaks(x)),
        differentiate_peaks=lambda *_: [np.array([[0.0], [slope]])],
    )
    design = SimpleNamespace(start=np.ones(1), variables=[SimpleNamespace(span=2.0)], storm_runs=storm_runs)
    monkeypatch.setattr(along_gradient, "first_windows", lambda _: [SimpleNamespace(case=None)])
    found = along_gradient.check_along(design)
    assert found.status == status
    if np.isfinite(slope):
        assert found.measured == pytest.approx(2.0 * 3.0 * 0.005 * 2.0)
        assert found.ratio == pytest.approx(3.0 / slope)
    warned = any("not_trusted" in text for text in design_warnings(0.0, 1.0, 0.2, (), found))
    assert warned == (status == "not_trusted")


def test_a_search_belongs_to_all_values_of_its_site_but_the_name():
    table = tomllib.loads(site_text("small-longline").decode())

    def digest(**sections):
        return digest_inputs(SimpleNamespace(site=read_site({**table, **sections})))

    higher = [{**table["sea_state"][0], "hs": 1.01 * table["sea_state"][0]["hs"]}, *table["sea_state"][1:]]
    stronger = [{**part, "factor": 2.5} for part in table["part"]]
    assert digest(name="another") == digest()
    assert len({digest(), digest(sea_state=higher), digest(part=stronger), digest(set={"sea.density": 1026.0})}) == 4


def test_parallel_runs_keep_their_order_and_the_first_is_alone_and_errors_are_raised():
    alone, seen = [], []

    def one(i):
        alone.append(threading.current_thread() is threading.main_thread())
        if i == 6:
            raise ValueError("six")
        return i * i

    assert run_parallel(one, list(range(6)), seen.append, workers=3) == [i * i for i in range(6)]
    assert alone[0]
    assert not any(alone[1:])
    assert seen == [1, 2, 3, 4, 5, 6]
    assert run_parallel(one, [], seen.append) == []
    with pytest.raises(ValueError, match="six"):
        run_parallel(one, [4, 5, 6, 7], lambda _: None, workers=2)


def test_runs_of_compiled_programs_start_together():
    both = threading.Barrier(2, timeout=10.0)  # broken unless two wait at the same time
    run_parallel(lambda _: both.wait(), [0, 1], lambda _: None, workers=2, alone=0)


def design_of(of, variables, **settings):
    """A design whose values and derivatives are known."""
    settings = {"margin": 0.0, "renew": 2, "enough": 1e-3, "reach": 0.4, **settings}
    with_slopes = lambda runs: SimpleNamespace(found=runs.found, slopes=["known"])  # noqa: E731
    return SimpleNamespace(
        settings=SimpleNamespace(**settings),
        variables=variables,
        storm_runs=SimpleNamespace(
            run_windows=lambda x, *_: SimpleNamespace(found=of(x), solved=True, slopes=[]),
            differentiate=lambda runs, say: with_slopes(runs),
        ),
        values=lambda runs: runs.found,
        measure=lambda x, say: ((), of(x)),
    )


def of_first(x, constraint=0.5):
    """The first variable as objective, and a constraint that does not change."""
    return Values(float(x[0]), np.ones(1), ("a",), np.array([constraint]), np.zeros((1, 1)))


def search_round(search, design):
    return run_round(search, design, (), lambda: None, silent)


def circle(x):
    """-x - y within x^2 + y^2 <= 2."""
    return Values(float(-x.sum()), -np.ones(2), ("circle",), np.array([x @ x / 2]), x[None])


def test_no_design_is_tried_twice_where_bounds_cut_a_step_short():
    """The objective rises against its slope, and the bound is nearer than the reach."""
    tried = []

    def looked(x):
        tried.append(float(x[0]))
        return Values(1.0 + (x[0] != 0.5), np.array([1.0]), ("a",), np.array([0.5]), np.zeros((1, 1)))

    design = design_of(looked, [SimpleNamespace(low=0.45, high=1.5, span=1.0)])
    search_round(Search(np.array([0.5]), 0.4, scale=1.0), design)
    assert tried[:2] == [0.5, 0.45]
    assert len(set(tried)) == len(tried) > 2


def test_a_design_whose_derivatives_cannot_be_run_is_not_taken():
    design = design_of(of_first, [SimpleNamespace(low=0.0, high=1.0, span=1.0)])
    differentiate = design.storm_runs.differentiate
    design.storm_runs.differentiate = lambda runs, say: (
        differentiate(runs, say) if runs.found.objective == 1.0 else runs
    )
    search = Search(np.ones(1), 0.4, scale=1.0)
    assert search_round(search, design).objective == search.x[0] == 1.0
    assert {row["failure"] for row in search.history} == {"steps of a window fail"}
    assert not any(row["taken"] for row in search.history)


def test_a_search_ends_at_a_start_whose_derivatives_cannot_be_run():
    variable = SimpleNamespace(low=0.0, high=1.0, span=1.0, catalogue=())
    design = design_of(lambda x: of_first(x, 1.5), [variable], rounds=8)
    design.storm_runs.differentiate = lambda runs, say: runs
    search = Search(np.ones(1), 0.4)
    run_search(search, design, lambda: None, silent)
    assert (search.round, search.best) == (1, None)


def test_the_last_step_of_a_round_is_not_differentiated():
    differences = []
    design = design_of(of_first, [SimpleNamespace(low=0.0, high=3.0, span=1.0)], renew=3, reach=0.1)
    differentiate = design.storm_runs.differentiate
    design.storm_runs.differentiate = lambda runs, say: (
        differences.append(runs.found.objective) or differentiate(runs, say)
    )
    search = Search(np.array([2.0]), 0.1, scale=1.0)
    found = search_round(search, design)
    assert sum(row["taken"] for row in search.history) == 3
    assert len(differences) == 3
    assert differences[-1] > found.objective


def test_steps_along_a_curved_limit_stay_long():
    """The minimum is -2 at 45 degrees, from a point of the circle."""
    tried = []
    angle = np.pi / 4 + 1.0
    design = design_of(
        lambda x: tried.append(x) or circle(x), [SimpleNamespace(low=-2.0, high=2.0, span=1.0)] * 2, renew=6, reach=0.3
    )
    found = search_round(Search(np.sqrt(2) * np.array([np.cos(angle), np.sin(angle)]), 0.3, scale=1.0), design)
    assert found.objective == pytest.approx(-2.0, abs=0.015)
    assert found.value[0] < 1.001  # 1.02 by linear steps alone
    assert len(tried) <= 20


@pytest.mark.parametrize("rounds", [1, 20])
def test_sizes_of_a_catalogue_are_taken_though_all_rounds_were_used(rounds):
    """x comes in halves: (1, 1)."""
    sizes = (0.0, 0.5, 1.0, 1.5, 2.0)
    ends = {"low": 0.0, "high": 2.0, "span": 2.0}
    near = lambda x: [s for s in sizes if abs(s - x) < 0.5]  # noqa: E731
    variables = [SimpleNamespace(**ends, catalogue=sizes, sizes=near), SimpleNamespace(**ends, catalogue=())]
    search = Search(np.array([0.3, 0.6]), 0.1)
    run_search(
        search, design_of(circle, variables, margin=1e-3, renew=3, reach=0.1, rounds=rounds), lambda: None, silent
    )
    assert search.done
    assert search.best[0] in sizes
    assert search.best @ search.best / 2 <= 1.0 + 1e-9
    if rounds > 1:
        np.testing.assert_allclose(search.best, [1.0, 1.0], atol=2e-3)
