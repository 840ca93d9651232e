"""Cross-validation and decisions between damping laws, against closed forms and draws."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hard_scenes import rods
from scipy.stats import chi2, multivariate_normal

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import Convention, Trace, prepare
from fitting.calibration import comparison
from fitting.estimate.normal_equations import Prior
from fitting.laws import compared_laws, joined_laws
from fitting.laws.cross_validation import Scores, blocks, last_third, other_runs, score_window
from fitting.laws.decision import chance, decide, decide_joined, shares, verdict
from fitting.laws.equivalent_laws import equivalent_laws
from fitting.laws.laws import LAW_PARTS, LAWS, Law, contains
from fitting.laws.undetected_parts import undetected_parts


def test_every_subset_of_the_parts_is_a_law_listed_after_those_it_contains():
    assert len(LAWS) == 2 ** len(LAW_PARTS) == len({frozenset(parts) for parts in LAWS.values()})
    names = list(LAWS)
    assert all(names.index(a) > names.index(b) for a in names for b in names if contains(a, b))


@pytest.mark.parametrize(
    ("laws", "left_out"),
    [
        (["linear", "joint viscous", "linear + joint viscous"], {"joint viscous": 0, "linear + joint viscous": 0}),
        (["joint viscous", "quadratic"], {}),
        (["linear + joint viscous"], {}),
    ],
    ids=["all", "none of the other", "no smaller one"],
)
def test_a_law_is_left_out_only_for_one_of_the_list_that_gives_the_same_motion(laws, left_out):
    """Of one link, a viscous joint acts as linear drag does."""
    names = [LAW_PARTS[part] for part in ("linear", "quadratic", "joint viscous")]
    jacobian = np.array([[1.0, 2.0, 0.5], [2.0, 1.0, 1.0]]).reshape(1, 2, 1, 3)
    fullest = SimpleNamespace(
        problem=SimpleNamespace(names=names, freedoms=0), evaluation=SimpleNamespace(jacobian=jacobian)
    )
    expected = {law: laws[i] for law, i in left_out.items()}
    assert equivalent_laws(laws, SimpleNamespace(names=[names[0]]), fullest) == expected


def test_a_window_is_scored_by_its_density_given_all_that_was_fitted():
    """Against the conditional density of a normal vector, from its dense covariance."""
    rng = np.random.default_rng(3)
    samples, links, m2, k = 12, 2, 2, 2
    jacobian = rng.standard_normal((samples, links, m2 + k))
    residual = rng.standard_normal((samples, links))
    early = np.zeros((samples, links), bool)
    early[:4] = True
    S, dp = np.array([[5.0, 1.0], [1.0, 3.0]]), np.array([0.2, -0.1])
    found, square, count = score_window(residual, jacobian, early, ~early, S, dp, np.full((samples, links), 2.0), m2)
    # residual + J theta is noise, theta = (start of any size, parameters)
    prior = np.zeros((m2 + k, m2 + k))
    prior[:m2, :m2], prior[m2:, m2:] = 1e4 * np.eye(m2), np.linalg.inv(S)
    A, W = jacobian[early], jacobian[~early]
    mean = np.concatenate([np.zeros(m2), dp])
    both = np.concatenate([A, W])
    covariance = both @ prior @ both.T + np.eye(len(both))
    n = len(A)
    gain = covariance[n:, :n] @ np.linalg.inv(covariance[:n, :n])
    centre = -W @ mean + gain @ (residual[early] + A @ mean)
    spread = covariance[n:, n:] - gain @ covariance[:n, n:]
    expected = multivariate_normal(centre, spread).logpdf(residual[~early]) + 0.5 * len(W) * np.log(2 * np.pi)
    assert found == pytest.approx(expected, abs=5e-3)
    assert square == pytest.approx(np.sum((residual[~early] - centre) ** 2) / 4, rel=1e-4)
    assert count == len(W)


def test_folds_score_every_window_once_and_fit_none_next_to_it():
    run = np.array([0] * 9 + [1] * 7)
    folds = blocks(run)
    assert np.all(sum(scored.astype(int) for scored, _ in folds) == 1)
    for scored, used in folds:
        assert scored.sum() >= 3
        for i in np.flatnonzero(used):
            assert not any(scored[j] and run[j] == run[i] for j in (i - 1, i, i + 1) if 0 <= j < len(run))
    ((scored, used),) = last_third(np.r_[np.arange(9.0), np.arange(7.0)], run)
    assert scored.sum() == 3 + 2
    assert not (scored & used).any()
    assert [scored.sum() for scored, _ in other_runs(run)] == [9, 7]
    assert other_runs(run[:9]) == []


@pytest.mark.parametrize("q", [1, 2])
def test_chance_of_a_gain_from_coefficients_on_their_bound_is_that_of_draws(q):
    """Two independent coefficients that cannot be negative: the gain is half the square of their positive parts."""
    draws = np.maximum(np.random.default_rng(0).standard_normal((200_000, q)), 0.0)
    gains = 0.5 * np.sum(draws**2, axis=1)
    for gain in (0.3, 1.0, 2.5):
        assert chance(gain, q) == pytest.approx(np.mean(gains > gain), rel=0.05)
    assert chance(1.0, 1) == pytest.approx(0.5 * chi2.sf(2.0, 1))
    assert chance(-1.0, q) == 1.0


def laws(costs: dict[str, float], **changes) -> list[Law]:
    """Laws by their names and costs."""
    sizes = {name: len(LAWS[name]) for name in costs}
    return [
        Law(name, sizes[name], 0.0, 0.0, 0.0, "ok", {}, free=sizes[name], cost=cost, **changes)
        for name, cost in costs.items()
    ]


def scores(*totals: float) -> list[Scores]:
    """Log scores of 10 windows that differ evenly."""
    spread = np.linspace(-0.1, 0.1, 10)
    return [Scores(total / 10 + total * spread * 0.01, np.ones(10), np.ones(10, int)) for total in totals]


@pytest.mark.parametrize(
    ("costs", "unseen", "logs", "words"),
    [
        # linear drag is needed, and nothing else
        ((50.0, 20.0, 25.0, 19.8), (), (-60.0, -30.0, -36.0, -30.5), "linear"),
        # no trace could have shown quadratic drag, which keeps its law possible; linear drag is in the simpler law too
        (
            (50.0, 20.0, 25.0, 19.8),
            ("quadratic",),
            (-60.0, -30.0, -36.0, -30.5),
            "undecided {linear, linear + quadratic}",
        ),
        ((50.0, 20.0, 25.0, 19.8), ("linear",), (-60.0, -30.0, -36.0, -30.5), "linear"),
        # the second part is worth 3.5 in log likelihood: neither shown nor needless
        ((50.0, 20.0, 30.0, 16.5), (), (-60.0, -30.0, -44.0, -29.8), "undecided {linear, linear + quadratic}"),
        ((50.0, 20.0, 30.0, 10.0), (), (-60.0, -30.0, -44.0, -20.0), "linear + quadratic"),
        ((50.0, 20.0, 20.5, 19.8), (), (-60.0, -30.0, -30.2, -30.4), "undecided {linear, quadratic}"),
    ],
)
def test_what_the_traces_leave_possible(costs, unseen, logs, words):
    rows = laws(dict(zip(("none", "linear", "quadratic", "linear + quadratic"), costs, strict=True)))
    rows = decide([*rows[:3], replace(rows[3], unseen=unseen)], scores(*logs))
    assert verdict(rows) == words
    assert sum(row.chosen for row in rows) == 1
    assert all(row.possible for row in rows if row.chosen)
    assert "lacks what" in rows[0].refuted


def test_two_parts_more_are_open_only_where_one_of_them_is():
    """Linear drag is imitated by quadratic drag and dry friction together, with any part of each excluded."""
    rows = laws({"linear": 20.0, "linear + quadratic": 19.9, "linear + dry": 19.9, "linear + quadratic + dry": 19.8})
    rows[3] = replace(rows[3], unseen=("linear", "quadratic", "dry"))
    logs = scores(-30.0, -30.5, -30.4, -31.0)
    assert verdict(decide(rows, logs)) == "linear"
    rows[2] = replace(rows[2], unseen=("dry",))
    assert verdict(decide(rows, logs)) == "undecided {linear, linear + dry, linear + quadratic + dry}"


def test_a_law_is_refuted_by_the_standard_error_that_is_reported():
    """Two windows in which the worse law loses 3.25 and 1.25: 4.5 +- 2.0, which is 2.25 standard errors."""
    lost = np.array([3.25, 1.25])
    logs = [Scores(-rows, np.ones(2), np.ones(2, int)) for rows in (lost, 0 * lost)]
    rows = decide(laws({"linear": 20.0, "quadratic": 20.0}), logs)
    assert verdict(rows) == "undecided {linear, quadratic}"
    assert rows[0].score == pytest.approx(-4.5)
    assert rows[0].score_error == pytest.approx(2.0)


def test_a_comparison_of_no_laws_is_refused():
    with pytest.raises(SceneError, match="laws: none given"):
        comparison.compare_laws(None, [])


def test_a_law_that_did_not_converge_is_ranked_by_its_cost():
    """Its cost is an upper limit; where that is too high, it may be the fit's fault, and is said so."""
    rows = laws({"none": 90.0, "dry": 20.0, "linear + dry": 19.9})
    rows[:2] = (replace(row, status="not_converged") for row in rows[:2])
    found = decide(rows, scores(-95.0, -30.0, -30.5))
    assert verdict(found) == "dry"
    assert found[0].refuted.startswith("not_converged; lacks what dry has")


@pytest.mark.filterwarnings("error")
def test_a_trace_of_one_window_is_decided_by_likelihood_alone():
    none = Scores(np.zeros(0), np.zeros(0), np.zeros(0, int))
    rows = decide(laws({"none": 50.0, "linear": 20.0, "linear + quadratic": 19.8}), [none] * 3)
    assert verdict(rows) == "linear"
    assert np.isnan([row.score_error for row in rows]).all()


def test_what_a_rough_cost_keeps_from_a_fit_is_no_evidence_for_a_larger_law():
    logs = scores(-95.0, -30.0, -30.5)
    rows = laws({"none": 90.0, "dry": 30.0, "linear + dry": 20.0})
    assert verdict(decide(rows, logs)) == "linear + dry"
    rows[1] = replace(rows[1], unreached=9.0)
    assert verdict(decide(rows, logs)) == "undecided {dry, linear + dry}"


def test_joined_windows_decide_between_the_laws_that_separate_ones_leave():
    costs = {"linear": 20.0, "quadratic": 50.0, "linear + quadratic": 19.8, "linear + dry": 19.9}
    rows = laws(costs | {"linear + quadratic + dry": 19.8}, unseen=("quadratic", "dry"))
    rows[0] = replace(rows[0], unseen=())
    rows = decide(rows, scores(-30.0, -60.0, -30.2, -30.1, -30.3))
    left = [row.name for row in rows if row.possible]
    assert left == ["linear", "linear + quadratic", "linear + dry", "linear + quadratic + dry"]
    costs = dict(zip(left, (31.0, 30.9, 22.0, 21.9), strict=True))
    found = decide_joined(rows, costs, dict.fromkeys(left, ()))
    assert verdict(found) == "linear + dry"
    assert {row.name: row.joined for row in found if row.name in left} == costs
    assert [row.name for row in found if row.chosen] == ["linear + dry"]
    open_parts = {**dict.fromkeys(left, ()), "linear + quadratic + dry": ("quadratic",)}
    assert verdict(decide_joined(rows, costs, open_parts)) == "undecided {linear + dry, linear + quadratic + dry}"
    assert verdict(decide_joined(rows, {}, {})) == verdict(rows)


def test_joined_windows_refute_a_law_that_is_much_less_likely():
    rows = decide(laws({"linear + quadratic": 20.0, "quadratic + dry": 20.5}), scores(-30.0, -30.2))
    for apart, words in ((3.0, "undecided {linear + quadratic, quadratic + dry}"), (5.0, "linear + quadratic")):
        costs = {"linear + quadratic": 25.0, "quadratic + dry": 25.0 + apart}
        assert verdict(decide_joined(rows, costs, dict.fromkeys(costs, ()))) == words


@pytest.mark.parametrize(("deviation", "left_open"), [(0.05, False), (0.2, True)])
def test_a_part_is_excluded_where_its_upper_limit_takes_less_than_a_tenth(deviation, left_open):
    """Coefficients 1.0 and -0.05 +- deviation, which take 3 and 2 J each per unit: a tenth of 3 J is 0.15 of it."""
    information = np.diag([1e6, deviation**-2])
    gradient = information @ [0.0, 0.05]
    none = Prior(0.0, np.zeros(2), np.zeros((2, 2)))
    problem = SimpleNamespace(held_mask=np.zeros(2, bool), memory=1.0, prior=lambda values: none)
    solution = SimpleNamespace(problem=problem, values=np.array([1.0, 0.0]), information=information, gradient=gradient)
    assert ("quadratic" in undetected_parts(solution, ("linear", "quadratic"), np.array([3.0, 2.0]))) == left_open


def test_shares_follow_the_scores_and_sum_to_one():
    found = shares(np.array([np.full(10, -1.0), np.full(10, -1.3), np.full(10, -3.0)]), np.random.default_rng(1))
    assert found.sum() == pytest.approx(1.0)
    assert found[1] / found[0] == pytest.approx(np.exp(-3.0), rel=1e-6)


def rod_trace(effects, duration, step, noise):
    """Scene of a rod let go at 1.1 rad, and its trace at 60 Hz with this noise [rad]; `step` steps a second."""
    scene = rods([1.1], 0.6, 0.3, effects)
    scene["run"] = {"dt": 1 / step, "duration": duration, "save_every": step // 60}
    run = dj.simulate(scene)
    d = np.diff(run.positions, axis=1)
    angle = np.unwrap(np.arctan2(d[..., 0], -d[..., 2]), axis=0)
    angle += noise * np.random.default_rng(0).standard_normal(angle.shape)
    return scene, Trace("rod", run.t, angle, convention=Convention("down", 1, "rad"))


@pytest.mark.check
@pytest.mark.parametrize(
    ("law", "effect", "field", "truth"),
    [("dry", "joint_friction", "dry", 0.02), ("linear", "linear_damping", "b_l", 0.03)],
)
def test_a_law_stuck_in_a_wrong_valley_is_fitted_again_from_a_larger_one(law, effect, field, truth, monkeypatch):
    """A law whose own fit is made to end with far too little of it; the larger one has its scheme, or another."""
    more = {"axis": [0.0, 1.0, 0.0]} if law == "dry" else {}
    scene, trace = rod_trace({effect: {field: truth, **more}}, 4.0, 240, 2e-3)
    honest = compared_laws.fit_law

    def stuck(prepared, family, name, inner):
        found = honest(prepared, family, name, inner)
        if name == law:
            values = 0.3 * found.values
            evaluation = found.problem.evaluate(values, found.starts)
            cost = found.problem.data_cost(evaluation)
            found = replace(found, values=values, evaluation=evaluation, cost=cost)
        return found

    for module in (compared_laws, joined_laws):
        monkeypatch.setattr(module, "fit_law", stuck)
    rows = comparison.compare_laws(prepare(trace, scene, [field]), laws=[law, "linear + dry"])
    laws = {one.name: one for one in rows}
    assert laws[law].values[f"effects.{effect}.{field}"] == pytest.approx(truth, rel=0.05)
    assert laws[law].cost < laws["linear + dry"].cost + 3


@pytest.mark.check
def test_a_pendulum_whose_windows_leave_laws_open_is_decided_where_they_are_joined():
    """Linear drag of one link, simulated with a finer step by another scheme, 3 mrad of noise."""
    scene, trace = rod_trace({"linear_damping": {"b_l": 0.0186}}, 12.0, 480, 3e-3)
    laws = comparison.compare_laws(prepare(trace, scene, ["b_l"]))
    joined = [law for law in laws if np.isfinite(law.joined)]
    assert len(joined) > 1
    assert verdict(laws) == "linear"
    by_name = {law.name: law.joined for law in joined}
    assert all(by_name[a] <= by_name[b] + 1e-6 for a in by_name for b in by_name if contains(a, b))
