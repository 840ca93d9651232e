"""The accuracy report of a scene: reference, work-precision rows, orders, advice, damping, claims, convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.evaluation.record import Record, record
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model, State
from dropper_jax.run.build import build
from dropper_jax.run.samples import is_finished
from dropper_jax.run.simulate import simulate
from dropper_jax.study.load_errors import line_loads
from dropper_jax.study.march import Scheme, convergence, default_schemes, grid_run, runnable, status_of
from dropper_jax.study.reference import Reference, reference, trusted_span
from dropper_jax.study.work_precision import Each, energy_loss, measure, orders

SCENE = "dropper-release-a-undamped"
#: Damping fitted in the thesis [kg/s], with its scheme and step [s].
THESIS_B_L = 0.002
THESIS_DT = 0.0065
THESIS = Scheme("thesis_angles", 0.51)
DAMPING_DTS = (2.0**-6, THESIS_DT, 2.0**-8, 2.0**-9, 2.0**-10, 2.0**-11)

REPORT_SCHEMES = (
    THESIS,
    Scheme("thesis_angles", 0.5),
    Scheme("theta", 0.51),
    Scheme("theta", 0.5),
    Scheme("theta", 1.0),
    Scheme("theta_midpoint", 0.51),
    Scheme("semi_implicit_euler"),
    Scheme("rattle"),
    Scheme("energy_momentum"),
)


def numerical_damping(
    schemes: tuple[Scheme, ...] = REPORT_SCHEMES,
    dts: tuple[float, ...] = DAMPING_DTS,
    scene: str = SCENE,
    duration: float = 6.5,
) -> dict[str, Any]:
    """Equivalent damping `b = E_lost / sum over nodes of the integral of |v|^2` [kg/s] of each scheme and step.

    A linear damping b on every node would dissipate the same energy along the same path. Negative values mean that the
    scheme gains energy. Failed runs have no value. Steps are not halved, so the value is that of the scheme itself.

    Returns:
        scene, duration_s, rows of {label, dt, status, failed_at_s, energy_lost_j, equivalent_linear_damping,
        share_of_thesis}; `thesis`: the row of the thesis' own scheme and step, with its fraction of the fitted b_l of
        0.002 kg/s.
    """
    model, s = build(load_scene(scene))
    rows = [_row(model, s, scheme, dt, duration) for scheme in schemes for dt in dts]
    found = {"scene": scene, "duration_s": duration, "thesis_b_l": THESIS_B_L, "rows": rows}
    return {**found, "thesis": _thesis(rows)}


def _row(model: Model, s: State, scheme: Scheme, dt: float, duration: float) -> dict[str, Any]:
    stepper = scheme.stepper(model, halvings=0)
    steps = int(np.ceil(duration / dt - 1e-9))
    run = grid_run(stepper, model, s, steps * dt, steps, 1)
    status = status_of(run, stepper)
    row = {"label": scheme.label, "integrator": scheme.integrator, "gamma": scheme.gamma, "dt": dt, "status": status}
    if status != "ok":
        failed = (int(run.bad[-1]) + 1) * dt
        nothing = {"energy_lost_j": None, "equivalent_linear_damping": None, "share_of_thesis": None}
        return {**row, "failed_at_s": failed, **nothing}
    lost = float(energy_loss(model, s, run, np.array([steps * dt]))[-1])
    b = lost / float(run.path[-1])
    return {
        **row,
        "failed_at_s": None,
        "energy_lost_j": lost,
        "equivalent_linear_damping": b,
        "share_of_thesis": b / THESIS_B_L,
    }


def _thesis(rows: list[dict[str, Any]]) -> dict[str, Any]:
    own = [row for row in rows if row["label"] == THESIS.label]
    at = next((row for row in own if row["dt"] == THESIS_DT), None)
    if at is None:
        return {}
    where = f"{THESIS.label} at dt {THESIS_DT:g} s on {SCENE}"
    if at["status"] == "ok":
        text = f"{where}: {100 * at['share_of_thesis']:.3g} % of b_l = {THESIS_B_L:g} kg/s is the scheme's own"
    else:
        text = f"{where}: {at['status']} at {at['failed_at_s']:.3g} s, so no share can be given"
        good = [row for row in own if row["status"] == "ok"]
        if good:
            largest = max(good, key=lambda row: row["dt"])
            share = 100 * largest["share_of_thesis"]
            text += f"; at dt {largest['dt']:.4g} s, where it survives, {share:.3g} %"
    return {**at, "text": text}


#: Default steps [s]: powers of two, which divide whole seconds and each other.
REPORT_DTS = tuple(2.0**-k for k in range(5, 12))
#: Default accuracies of the runs for the loads.
LOAD_ACCURACIES = (0.1, 0.01, 1e-3, 1e-4)
#: Maximum relative error of each load for the advice.
WANTED = {"mean": 0.01, "deviation": 0.02, "window_maximum": 0.05, "maximum": 0.08}


def accuracy(
    scene: Scene,
    schemes: list[Scheme] | None = None,
    dts: tuple[float, ...] | None = None,
    span: float | None = None,
    extras: bool = True,
    say: Progress | None = None,
    each: Each = lambda row: None,
) -> dict[str, Any]:
    """Measure accuracy against run time on a scene.

    Args:
        schemes: schemes to compare; default: all that can run the scene.
        dts: equal steps [s]; default: `REPORT_DTS`, and for the loads `LOAD_ACCURACIES` if the scene has an accuracy.
        span: duration of the comparison [s]; default: until a perturbation has grown 100 times, at most 20 s.
        extras: also the numerical damping, the claims on Euler's schemes and the convergence by link. Without them
            each scheme is run once, with its own solver in double precision, and steps that do not converge are not
            halved.
        each: gets each row of a scheme or of the loads as soon as it is measured.

    Returns:
        rows, orders, advice, reference, refused, skipped, for lines that stretch `loads` (see `load_convergence`), and
        the extras, as the command prints them. After an interruption (Ctrl-C) what was measured, with the `status`
        "interrupted".
    """
    model, s = build(scene, "float64")
    chosen, refused = runnable(default_schemes(model, not extras) if schemes is None else schemes, model)
    if not chosen:
        raise SceneError(f"--integrators: none of them can run this scene: {refused[0]['reason']}")
    found: dict[str, Any] = {"scene": scene.name, "rows": [], "reference": None, "refused": refused, "skipped": []}
    steps = REPORT_DTS if dts is None else dts
    study = _Study(scene, model, s, steps, say or silent, each, found)
    try:
        if model.line.axial.elastic:
            study.measure_loads(
                by_accuracy=dts is None and scene.run.accuracy is not None
            )  # first: the programs of runs are compiled sooner than those of the comparison
        target = study.find_reference(span)
        study.measure_schemes(chosen, target, extras)
        if extras:
            found |= _extras(model, s, target, steps, study.say)
    except KeyboardInterrupt:
        found["status"] = "interrupted"
    found["orders"] = orders(found["rows"])
    found["advice"] = advice(found["rows"])
    return found


#: Maximum duration of a comparison [s].
LONGEST_COMPARISON = 20.0


@dataclass(frozen=True)
class _Study:
    """The parts of the report; each is written to `found` as soon as it is known."""

    scene: Scene
    model: Model
    s: State
    dts: tuple[float, ...]
    say: Progress
    each: Each
    found: dict[str, Any]

    def find_reference(self, span: float | None) -> Reference:
        """The reference over the time during which errors characterise a scheme, or over `span` [s]."""
        self.say(0.3, "how long errors mean something")
        grid = max(self.dts)
        run = self.scene.run
        longest = max(min(run.duration, LONGEST_COMPARISON), 2 * grid)
        trusted, exponent = trusted_span(self.model, self.s, longest, min(run.step, grid), grid)
        saves = max(2, round(trusted / grid) if span is None else round(span / grid))
        self.say(0.35, f"reference over {saves * grid:.3g} s")
        target = reference(self.model, self.s, grid, saves, exponent)
        self.found["reference"] = {**target.summary(), "trusted_span_s": trusted}
        return target

    def measure_schemes(self, schemes: list[Scheme], target: Reference, extras: bool) -> None:
        """A row for each scheme and step."""
        part = 0.3 if extras else 0.6

        def say(fraction: float, text: str) -> None:
            self.say(0.4 + part * fraction, text)

        _, skipped = measure(
            self.model, self.s, schemes, list(self.dts), target, say=say, retry=extras, each=self._keep_row
        )
        self.found["skipped"] = skipped

    def _keep_row(self, row: dict[str, Any]) -> None:
        self.found["rows"].append(row)
        self.each(row)

    def measure_loads(self, by_accuracy: bool) -> None:
        """Errors of the loads over the accuracy or the step."""

        def say(fraction: float, text: str) -> None:
            self.say(0.3 * fraction, text)

        self.found["loads"] = {"rows": [], "reference_dt": None, "loads": [], "advice": [], "skipped": "interrupted"}
        if by_accuracy:
            steps = [{"accuracy": value} for value in LOAD_ACCURACIES]
        else:
            steps = [{"dt": dt} for dt in self.dts]
        self.found["loads"] = load_convergence(self.scene, steps, say=say, each=self._keep_load_row)

    def _keep_load_row(self, row: dict[str, Any]) -> None:
        self.found["loads"]["rows"].append(row)
        self.each(row)


def _extras(model: Model, s: State, target: Reference, dts: tuple[float, ...], say: Progress) -> dict[str, Any]:
    say(0.7, "convergence by link")  # first, by the programs of the rows, which later ones would displace
    found = convergence(model, s, target.grid, len(target.t), list(dts))
    say(0.75, "numerical damping")
    damping = numerical_damping()
    say(0.92, "Euler's schemes")
    return {"numerical_damping": damping, "euler": euler_claims(), "convergence": found}


def advice(
    rows: list[dict[str, Any]], targets: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
) -> list[dict[str, Any]]:
    """The run of the least counted work for each RMS angle error [rad], with its margin (target over error).

    Counted work, unlike a measured time, gives the same advice on a busy machine and after a first compilation.
    """
    return [_cheapest_run(rows, target) for target in targets]


def _cheapest_run(rows: list[dict[str, Any]], target: float) -> dict[str, Any]:
    good = [r for r in rows if r["status"] == "ok" and r["rms_angle_error_rad"] <= target]
    if not good:
        return {"target_rad": target, "found": False, "text": f"for {target:g} rad: no measured run is accurate enough"}
    best = min(good, key=lambda r: (r["operations_per_simulated_s"], r["rms_angle_error_rad"]))
    margin = target / max(best["rms_angle_error_rad"], 1e-300)
    ms = 1e3 * best["wall_s_per_simulated_s"]
    held = best.get("accuracy")
    if held is None:
        step = f"dt {best['dt']:.4g} s"
    else:
        step = f"accuracy {held:.2g}"
    scheme = best["label"].removesuffix(", accuracy")
    return {
        "target_rad": target,
        "found": True,
        "scheme": scheme,
        "integrator": best["integrator"],
        "gamma": best["gamma"],
        "solver": best["solver"],
        "dtype": best["dtype"],
        "dt": best["dt"],
        **({} if held is None else {"accuracy": held}),
        "ms_per_simulated_s": ms,
        "rms_angle_error_rad": best["rms_angle_error_rad"],
        "margin": margin,
        "text": f"for {target:g} rad use {scheme} at {step}: {ms:.3g} ms per simulated second "
        f"(error {best['rms_angle_error_rad']:.2g} rad, margin {margin:.2g})",
    }


#: Maximum duration of the comparison of loads [s].
LONGEST_LOADS = 60.0


def load_convergence(
    scene: Scene,
    steps: Sequence[Mapping[str, float]],
    skip: float = 0.0,
    say: Progress = silent,
    each: Each = lambda row: None,
) -> dict[str, Any]:
    """Errors of the loads of each line, relative to a run with half the finest step, by the scheme of the scene.

    Args:
        steps: {accuracy} or {dt [s]} of each run.
        each: gets each row as soon as the next finer one was run, with its errors relative to that.

    Returns:
        `rows`: {accuracy or None, dt, status, us_per_step, errors: by load the maximum relative error over the lines,
        or None}, dt the mean step of an accuracy; `reference_dt`, `loads` of the reference by line; `advice`: {load,
        within, accuracy, dt, text}: the coarsest row for which it and all finer ones are within the limit, or None. If
        the motion is chaotic, errors do not decrease below the random difference of two runs.
    """
    scene = scene.with_values({"run.duration": min(scene.run.duration, LONGEST_LOADS)})
    (key,) = steps[0]
    values = sorted((step[key] for step in steps), reverse=True)
    # errors of the second order: a quarter of the accuracy takes half of the step
    finest = values[-1] * (0.25 if key == "accuracy" else 0.5)
    runs: list[_LoadRun] = []
    for i, value in enumerate([*values, finest]):
        say(i / (len(values) + 1), f"loads, {key} {value:.4g}")
        runs.append(_LoadRun.of(scene, {key: value}, skip))
        if i > 0:
            each(runs[-2].row(runs[-1].loads()))
    *coarser, reference_run = runs
    right = reference_run.loads()
    reference_dt = reference_run.dt
    if right is None:
        return {"rows": [], "reference_dt": reference_dt, "loads": [], "advice": [], "skipped": reference_run.failure}
    rows = [run.row(right) for run in coarser]
    advice = [_advice(rows, name, within) for name, within in WANTED.items()]
    loads = []
    for row in right:
        loads.append({"line": row["line"], "at_m": row["at_m"], **{name: row[name][0] for name in WANTED}})
    return {"rows": rows, "reference_dt": reference_dt, "loads": loads, "advice": advice}


@dataclass(frozen=True)
class _LoadRun:
    """A run for its loads: its record, None if it failed or is too short; `dt` is the mean step of an accuracy."""

    accuracy: float | None
    dt: float
    status: str
    us_per_step: float
    failure: str
    record: Record | None

    @classmethod
    def of(cls, scene: Scene, step: Mapping[str, float], skip: float) -> _LoadRun:
        """The run with an accuracy or equal steps, without its first `skip` seconds."""
        solution = simulate(scene, **step)
        if solution.status == "interrupted":  # the part that `simulate` keeps has no loads to compare
            raise KeyboardInterrupt
        good = is_finished(solution) and len(solution.t) > 3
        kept = record(solution, skip) if good else None
        dt = float(solution.t[-1] - solution.t[0]) / max(solution.settings["steps"], 1)
        return cls(step.get("accuracy"), dt, solution.status, solution.us_per_step, solution.failure, kept)

    def loads(self, right: list[dict[str, Any]] | None = None) -> list[dict[str, Any]] | None:
        """Loads of each line, at the positions of `right`."""
        if self.record is None:
            return None
        return line_loads(self.record, right)

    def row(self, right: list[dict[str, Any]] | None) -> dict[str, Any]:
        """Its errors relative to the loads of a finer run."""
        loads = None if right is None else self.loads(right)
        errors = {name: None if loads is None else _worst(loads, right, name) for name in WANTED}
        return {
            "accuracy": self.accuracy,
            "dt": self.dt,
            "status": self.status,
            "us_per_step": self.us_per_step,
            "errors": errors,
        }


def _worst(loads: list[dict[str, Any]], right: list[dict[str, Any]], name: str) -> float:
    """Maximum relative error over the lines; that of a standard deviation is relative to the mean if this is larger."""
    scale = [max(abs(row[name][0]), 1e-3 * abs(row["mean"][0]), 1e-300) for row in right]
    return max(abs(a[name][0] - b[name][0]) / s for a, b, s in zip(loads, right, scale, strict=True))


def _advice(rows: list[dict[str, Any]], name: str, within: float) -> dict[str, Any]:
    best: dict[str, Any] = {"accuracy": None, "dt": None}
    for row in reversed(rows):  # from the finest upwards: an accurate run above an inaccurate one does not count
        error = row["errors"][name]
        if error is None or error > within or row["status"] != "ok":
            break
        best = row
    found = "not reached with the tested steps"
    if best["accuracy"] is not None:
        found = f"accuracy {best['accuracy']:.2g} or less"
    elif best["dt"] is not None:
        found = f"steps of {best['dt']:.4g} s or less"
    text = f"{name.replace('_', ' ')} within {within:.0%}: {found}"
    return {"load": name, "within": within, "accuracy": best["accuracy"], "dt": best["dt"], "text": text}


#: Scheme, claim of the thesis (sections 2.3, 4.3.1 and its conclusion), and the corresponding sign.
CLAIMS = (
    (Scheme("theta", 0.0), "explicit Euler gains energy", 1),
    (Scheme("theta", 1.0), "implicit Euler loses energy", -1),
    (Scheme("semi_implicit_euler"), "semi-implicit Euler does neither", 0),
)
EULER_DURATION = 5.0


def single_pendulum() -> Scene:
    """A pendulum of 1 m and 1 kg released at 45 degrees, in a plane."""
    side = float(np.sqrt(0.5))
    return load_scene(
        {
            "name": "single-pendulum",
            "run": {"dt": 0.01, "duration": EULER_DURATION},
            "point": [
                {"name": "pivot", "position": [0.0, 0.0, 0.0]},
                {"name": "bob", "kind": "free", "position": [side, 0.0, -side]},
            ],
            "line": [{"name": "pendulum", "from": "pivot", "to": "bob", "links": 1, "length": 1.0, "mass": 1.0}],
            "effects": {"weight": {}},
            "start": {"kind": "angles", "zero": "down", "polar": [float(np.pi / 4)]},
        }
    )


#: A change smaller than this fraction of the mean of the other two is neither gain nor loss.
SMALL_CHANGE = 0.1


def euler_claims(
    dts: tuple[float, ...] = (0.01, 0.005, 0.0025), duration: float = EULER_DURATION
) -> list[dict[str, Any]]:
    """Energy gained over `duration` [s] by the three schemes at each step, over the energy scale, and whether the claim
    holds.

    Returns:
        rows of {scene, label, claim, dt, status, energy_gained, holds}; energies over the potential energy released.
    """
    rows = []
    for scene in (single_pendulum(), load_scene("double-pendulum-periodic")):
        for dt in dts:
            gained = [_gain(scene, scheme, dt, duration) for scheme, _, _ in CLAIMS]
            typical = SMALL_CHANGE * 0.5 * (abs(gained[0][1]) + abs(gained[1][1]))
            for (scheme, claim, sign), (status, gain) in zip(CLAIMS, gained, strict=True):
                holds = status == "ok" and (abs(gain) < typical if sign == 0 else sign * gain > 0)
                row = {"scene": scene.name, "label": scheme.label, "claim": claim, "dt": dt, "status": status}
                rows.append({**row, "energy_gained": gain, "holds": bool(holds)})
    return rows


def _gain(scene: Scene, scheme: Scheme, dt: float, duration: float) -> tuple[str, float]:
    model, s = build(scene)
    stepper = scheme.stepper(model, halvings=0)
    steps = round(duration / dt)
    run = grid_run(stepper, model, s, steps * dt, steps, 1)
    lost = energy_loss(model, s, run, np.array([duration]))[-1]
    lowest = jnp.sum(model.line.mass * GRAVITY * -jnp.cumsum(model.line.length))
    start = model.potential_energy(model.kinematics(s.r, s.v, s.t))
    return status_of(run, stepper), -float(lost) / float(start - lowest)
