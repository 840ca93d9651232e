"""The accuracy report of a scene: reference, work-precision rows, orders, advice, damping, claims, convergence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from operator import itemgetter

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, part_of, silent
from dropper_jax.base.read import Table
from dropper_jax.base.records import select_keys
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import build
from dropper_jax.study.convergence import convergence
from dropper_jax.study.damping import numerical_damping
from dropper_jax.study.euler_claims import euler_claims
from dropper_jax.study.load_convergence import LOAD_ACCURACIES, load_convergence
from dropper_jax.study.reference import Reference, reference, trusted_span
from dropper_jax.study.schemes import Scheme, default_schemes, runnable
from dropper_jax.study.work_precision import Comparison, Each, orders

#: Default steps [s]: powers of two, which divide whole seconds and each other.
REPORT_DTS = tuple(2.0**-k for k in range(5, 12))


def accuracy(
    scene: Scene,
    schemes: list[Scheme] | None = None,
    dts: tuple[float, ...] | None = None,
    span: float | None = None,
    extras: bool = True,
    progress: Progress = silent,
    each: Each = lambda row: None,
) -> Table:
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
    if schemes is None:
        schemes = default_schemes(model, quick=not extras)
    chosen, refused = runnable(schemes, model)
    if not chosen:
        raise SceneError(f"--integrators: none of them can run this scene: {refused[0]['reason']}")
    found: Table = {"scene": scene.name, "rows": [], "reference": None, "refused": refused, "skipped": []}
    steps = REPORT_DTS if dts is None else dts
    study = _Study(scene, model, s, steps, progress, each, found)
    try:
        # first the loads: the programs of runs are compiled sooner than those of the comparison
        if model.line.axial.elastic:
            study.measure_loads(by_accuracy=dts is None and scene.run.accuracy is not None)
        target = study.find_reference(span)
        study.measure_schemes(chosen, target, extras)
        if extras:
            found |= _extras(model, s, target, steps, study.progress)
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
    progress: Progress
    each: Each
    found: Table

    def find_reference(self, span: float | None) -> Reference:
        """The reference over the time during which errors characterise a scheme, or over `span` [s]."""
        self.progress(0.3, "how long errors mean something")
        grid = max(self.dts)
        run = self.scene.run
        longest = max(min(run.duration, LONGEST_COMPARISON), 2 * grid)
        trusted, exponent = trusted_span(self.model, self.s, longest, min(run.step, grid), grid)
        if span is None:
            span = trusted
        saves = max(2, round(span / grid))
        self.progress(0.35, f"reference over {saves * grid:.3g} s")
        target = reference(self.model, self.s, grid, saves, exponent)
        self.found["reference"] = {**target.summary(), "trusted_span_s": trusted}
        return target

    def measure_schemes(self, schemes: list[Scheme], target: Reference, extras: bool) -> None:
        """A row for each scheme and step."""
        end = 0.7 if extras else 1.0
        progress = part_of(self.progress, 0.4, end)
        for row in Comparison(self.model, self.s, target).rows(schemes, self.dts, extras, progress):
            if "reason" in row:
                self.found["skipped"].append(row)
            else:
                self._keep_row(self.found["rows"], row)

    def _keep_row(self, rows: list[Table], row: Table) -> None:
        rows.append(row)
        self.each(row)

    def measure_loads(self, by_accuracy: bool) -> None:
        """Errors of the loads over the accuracy or the step."""
        rows: list[Table] = []
        self.found["loads"] = {"rows": rows, "reference_dt": None, "loads": [], "advice": [], "skipped": "interrupted"}
        key, values = "dt", self.dts
        if by_accuracy:
            key, values = "accuracy", LOAD_ACCURACIES
        keep = partial(self._keep_row, rows)
        self.found["loads"] = load_convergence(
            self.scene, key, values, progress=part_of(self.progress, 0.0, 0.3), each=keep
        )


def _extras(model: Model, s: State, target: Reference, dts: tuple[float, ...], progress: Progress) -> Table:
    """Convergence by link, numerical damping and the claims on Euler's schemes."""
    progress(0.7, "convergence by link")  # first, by the programs of the rows, which later ones would displace
    found = convergence(model, s, target.grid, len(target.t), list(dts))
    progress(0.75, "numerical damping")
    damping = numerical_damping()
    progress(0.92, "Euler's schemes")
    return {"numerical_damping": damping, "euler": euler_claims(), "convergence": found}


def advice(rows: list[Table], targets: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)) -> list[Table]:
    """The run with the minimum counted work for each RMS angle error [rad], with its margin (target over error).

    Counted work, unlike a measured time, gives the same advice on a busy machine and after a first compilation.
    """
    return [_cheapest_run(rows, target) for target in targets]


def _cheapest_run(rows: list[Table], target: float) -> Table:
    """The advice for one error [rad]."""
    good = [r for r in rows if r["status"] == "ok" and r["rms_angle_error_rad"] <= target]
    if not good:
        return {"target_rad": target, "found": False, "text": f"for {target:g} rad: no measured run is accurate enough"}
    best = min(good, key=itemgetter("operations_per_simulated_s", "rms_angle_error_rad"))
    error = best["rms_angle_error_rad"]
    margin = target / max(error, 1e-300)
    ms = 1e3 * best["wall_s_per_simulated_s"]
    step = f"dt {best['dt']:.4g} s"
    if "accuracy" in best:
        step = f"accuracy {best['accuracy']:.2g}"
    scheme = best["label"].removesuffix(", accuracy")
    keys = ("integrator", "gamma", "solver", "dtype", "dt", "accuracy", "rms_angle_error_rad")
    return {
        "target_rad": target,
        "found": True,
        "scheme": scheme,
        **select_keys(best, keys),
        "ms_per_simulated_s": ms,
        "margin": margin,
        "text": f"for {target:g} rad use {scheme} at {step}: {ms:.3g} ms per simulated second "
        f"(error {error:.2g} rad, margin {margin:.2g})",
    }
