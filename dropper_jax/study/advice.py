"""Which scheme and step to take for an error that is wanted."""

from __future__ import annotations

from typing import Any

#: Errors [rad] that advice is given for.
TARGETS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)


def advice(rows: list[dict[str, Any]], targets: tuple[float, ...] = TARGETS) -> list[dict[str, Any]]:
    """For each RMS angle error [rad] the cheapest measured run that meets it, with its margin (target over error)."""
    return [_one(rows, target) for target in targets]


def _one(rows: list[dict[str, Any]], target: float) -> dict[str, Any]:
    good = [r for r in rows if r["status"] == "ok" and not r.get("peer") and r["rms_angle_error_rad"] <= target]
    if not good:
        return {"target_rad": target, "found": False, "text": f"for {target:g} rad: no measured run is good enough"}
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
