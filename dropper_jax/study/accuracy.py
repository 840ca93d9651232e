"""The accuracy report of a scene: reference, work-precision rows, orders, advice, damping, claims, convergence."""

from __future__ import annotations

from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.report.record import record
from dropper_jax.run.build import build
from dropper_jax.run.samples import is_finished
from dropper_jax.run.simulate import simulate
from dropper_jax.study.convergence import convergence
from dropper_jax.study.euler import euler_claims
from dropper_jax.study.load_errors import line_loads
from dropper_jax.study.numerical_damping import numerical_damping
from dropper_jax.study.peers import peer_rows
from dropper_jax.study.reference import Reference, reference, trusted_span
from dropper_jax.study.schemes import Scheme, default_schemes, runnable
from dropper_jax.study.work_precision import measure, orders

#: Default steps [s]: powers of two, which divide whole seconds and each other.
DTS = tuple(2.0**-k for k in range(5, 12))
#: Maximum duration of a comparison [s].
LONGEST = 20.0
#: Target errors [rad] of the advice.
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
#: Maximum relative error of each load for the advice.
WANTED = {"mean": 0.01, "deviation": 0.02, "window_maximum": 0.05, "maximum": 0.08}
#: Maximum duration of the comparison of loads [s].
LONGEST_RUN = 60.0


def accuracy(
    scene: Scene,
    schemes: list[Scheme] | None = None,
    dts: tuple[float, ...] = DTS,
    span: float | None = None,
    extras: bool = True,
    say: Progress | None = None,
    peers: bool = False,
) -> dict[str, Any]:
    """Measure accuracy against run time on a scene.

    Args:
        schemes: schemes to compare; default: all that can run the scene.
        dts: steps [s].
        span: duration of the comparison [s]; default: until a perturbation has grown 100 times, at most 20 s.
        extras: also the numerical damping, the claims on Euler's schemes and the convergence by link. Without them
            each scheme is run once, with its own solver in double precision, and steps that do not converge are not
            halved.
        peers: also rows of other simulators, if they are installed and support the scene.

    Returns:
        rows, orders, advice, reference, refused, skipped, for lines that stretch `loads` (see `load_convergence`), and
        the extras, as the command prints them.
    """
    say = say or silent
    model, s = build(scene, "float64")
    chosen, refused = runnable(default_schemes(model, not extras) if schemes is None else schemes, model)
    if not chosen:
        raise SceneError(f"--integrators: none of them can run this scene: {refused[0]['reason']}")
    say(0.0, "how long errors mean something")
    grid = max(dts)
    longest = max(min(scene.run.duration, LONGEST), 2 * grid)
    trusted, exponent = trusted_span(model, s, longest, min(scene.run.dt, grid), grid)
    saves = max(2, round(trusted / grid) if span is None else round(span / grid))
    say(0.1, f"reference over {saves * grid:.3g} s")
    target = reference(model, s, grid, saves, exponent)
    part = 0.4 if extras else 0.6
    rows, skipped = measure(
        model, s, chosen, list(dts), target, say=lambda f, text: say(0.2 + part * f, text), retry=extras
    )
    if peers:
        others, left = peer_rows(scene, model, s, target)
        rows, refused = rows + others, refused + left
    found = {
        "scene": scene.name,
        "rows": rows,
        "orders": orders(rows),
        "advice": advice(rows),
        "reference": {**target.summary(), "trusted_span_s": trusted},
        "refused": refused,
        "skipped": skipped,
    }
    if model.line.axial.elastic:
        found["loads"] = load_convergence(scene, dts, say=lambda f, text: say(0.6 + 0.1 * f, text))
    return {**found, **(_extras(model, s, target, dts, say) if extras else {})}


def _extras(model: Model, s: State, target: Reference, dts: tuple[float, ...], say: Progress) -> dict[str, Any]:
    say(0.7, "numerical damping")
    damping = numerical_damping()
    say(0.85, "Euler's schemes")
    claims = euler_claims()
    say(0.92, "convergence by link")
    return {
        "numerical_damping": damping,
        "euler": claims,
        "convergence": convergence(model, s, target.grid, len(target.t), list(dts)),
    }


def advice(rows: list[dict[str, Any]], targets: tuple[float, ...] = TARGETS) -> list[dict[str, Any]]:
    """The fastest measured run for each RMS angle error [rad], with its margin (target over error)."""
    return [_cheapest_run(rows, target) for target in targets]


def _cheapest_run(rows: list[dict[str, Any]], target: float) -> dict[str, Any]:
    good = [r for r in rows if r["status"] == "ok" and not r.get("peer") and r["rms_angle_error_rad"] <= target]
    if not good:
        return {"target_rad": target, "found": False, "text": f"for {target:g} rad: no measured run is accurate enough"}
    best = min(good, key=lambda r: r["wall_s_per_simulated_s"])
    margin = target / max(best["rms_angle_error_rad"], 1e-300)
    ms = 1e3 * best["wall_s_per_simulated_s"]
    held = best.get("error_tolerance")
    step = f"dt {best['dt']:.4g} s" if held is None else f"error_tolerance {held:.2g}"
    return {
        "target_rad": target,
        "found": True,
        "scheme": best["label"],
        "integrator": best["integrator"],
        "gamma": best["gamma"],
        "solver": best["solver"],
        "dtype": best["dtype"],
        "dt": best["dt"],
        **({} if held is None else {"error_tolerance": held}),
        "ms_per_simulated_s": ms,
        "rms_angle_error_rad": best["rms_angle_error_rad"],
        "margin": margin,
        "text": f"for {target:g} rad use {best['label']} at {step}: {ms:.3g} ms per simulated second "
        f"(error {best['rms_angle_error_rad']:.2g} rad, margin {margin:.2g})",
    }


def load_convergence(scene: Scene, dts: tuple[float, ...], skip: float = 0.0, say: Progress = silent) -> dict[str, Any]:
    """Errors of the loads of each line at steps `dts` [s], relative to half the shortest step, by the scheme of the
    scene.

    Returns:
        `rows`: {dt, status, us_per_step, errors: by load the maximum relative error over the lines, or None};
        `reference_dt`, `loads` of the reference by line; `advice`: {load, within, dt, text}, dt the largest step for
        which it and all smaller ones are within the limit, or None. If the motion is chaotic, errors do not decrease
        below the random difference of two runs.
    """
    scene = scene.with_values({"run.duration": min(scene.run.duration, LONGEST_RUN)})
    steps = sorted(dts, reverse=True)
    reference_dt = 0.5 * steps[-1]
    say(0.0, f"loads, {reference_dt:.4g} s")
    finest = simulate(scene, dt=reference_dt)
    if not is_finished(finest):
        return {"rows": [], "reference_dt": reference_dt, "loads": [], "advice": [], "skipped": finest.failure}
    right = line_loads(record(finest, skip))
    rows = []
    for i, dt in enumerate(steps):
        say((i + 1) / (len(steps) + 1), f"loads, {dt:.4g} s")
        found = simulate(scene, dt=dt)
        good = is_finished(found) and len(found.t) > 3
        loads = line_loads(record(found, skip), right) if good else None
        errors = {name: None if loads is None else _worst(loads, right, name) for name in WANTED}
        rows.append({"dt": dt, "status": found.status, "us_per_step": found.us_per_step, "errors": errors})
    advice = [_advice(rows, name, within) for name, within in WANTED.items()]
    loads = [{"line": row["line"], "at_m": row["at_m"], **{name: row[name][0] for name in WANTED}} for row in right]
    return {"rows": rows, "reference_dt": reference_dt, "loads": loads, "advice": advice}


def _worst(loads: list[dict[str, Any]], right: list[dict[str, Any]], name: str) -> float:
    """Maximum relative error over the lines; that of a standard deviation is relative to the mean if this is larger."""
    scale = [max(abs(row[name][0]), 1e-3 * abs(row["mean"][0]), 1e-300) for row in right]
    return max(abs(a[name][0] - b[name][0]) / s for a, b, s in zip(loads, right, scale, strict=True))


def _advice(rows: list[dict[str, Any]], name: str, within: float) -> dict[str, Any]:
    best = None
    for row in reversed(
        rows
    ):  # from the shortest step upwards: an accurate step above an inaccurate one does not count
        error = row["errors"][name]
        if error is None or error > within or row["status"] != "ok":
            break
        best = row["dt"]
    what = f"{name.replace('_', ' ')} within {within:.0%}"
    text = f"{what}: not reached with the tested steps" if best is None else f"{what}: steps of {best:.4g} s or less"
    return {"load": name, "within": within, "dt": best, "text": text}
