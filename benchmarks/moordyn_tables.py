"""Tables on MoorDyn and steps in docs/ from `results/moordyn.json`, which `benchmarks/moordyn.py` writes."""

from __future__ import annotations

from typing import Any

Rows = list[tuple[str, ...]]

#: The step of ours that stands in the speed table where none is as exact as MoorDyn [s].
USUAL = 0.02


def cases(found: dict[str, Any]) -> Rows:
    """Motion of the buoy and mean tensions of the paper's cases in both codes, at the ratio of 0.1."""
    head = ("case", "code", "buoy, range along the waves [m]", "range of z [m]")
    rows = [(*head, "mean anchor [N], whole / after 50 s", "mean fairlead [N]", "largest, anchor [kN]")]
    for case in found["cases"]:
        if case["damping_ratio"] != 0.1:
            continue
        for code, name in (("ours", "here"), ("moordyn", "MoorDyn v2")):
            whole, settled = case[code]["whole"], case[code]["settled"]
            low, high = whole["place"]["min"], whole["place"]["max"]
            anchor, fairlead = (f"{whole[key]['mean']:.0f} / {settled[key]['mean']:.0f}" for key in ENDS)
            ranges = (f"{low[0]:.1f} to {high[0]:.1f}", f"{low[2]:.2f} to {high[2]:.2f}")
            rows.append((str(case["case"]), name, *ranges, anchor, fairlead, _kilo(whole["anchor"]["max"])))
    return rows


ENDS = ("anchor", "fairlead")


def ratios(found: dict[str, Any]) -> Rows:
    """Case 1 at several internal damping ratios: mean, least and largest anchor tension in both codes."""
    rows = [("damping ratio", "code", "mean anchor after 50 s [N]", "least [kN]", "largest [kN]")]
    for case in found["cases"]:
        if case["case"] == 1:
            for code, name in (("ours", "here"), ("moordyn", "MoorDyn v2")):
                tension = case[code]["settled"]["anchor"]
                numbers = (f"{tension['mean']:.0f}", _kilo(tension["min"]), _kilo(tension["max"]))
                rows.append((f"{case['damping_ratio']:g}", name, *numbers))
    return rows


def conventions(found: dict[str, Any]) -> Rows:
    """Static anchor tension of case 4 by conventions."""
    rows = [("case 4", "anchor tension [N]")]
    return rows + [(row["convention"], f"{row['anchor_n']:.1f}") for row in found["case_4"]]


def steps(found: dict[str, Any]) -> Rows:
    """Mean anchor tension of case 1 by damping ratio and step, and its difference from that at the smallest step."""
    sizes = sorted({row["dt_s"] for row in found["step_sizes"]}, reverse=True)
    by_place = {(row["damping_ratio"], row["dt_s"]): row for row in found["step_sizes"]}
    rows = [("damping ratio", *(f"dt {dt:g}" for dt in sizes), "steps retried, at most")]
    for ratio in dict.fromkeys(row["damping_ratio"] for row in found["step_sizes"]):
        own = [by_place[ratio, dt] for dt in sizes]
        cells = [f"{row['anchor']['mean']:.0f} N ({row['mean_against_smallest_step']:+.1%})" for row in own[:-1]]
        cells += [f"{own[-1]['anchor']['mean']:.0f} N", f"{max(row['retried'] for row in own):.1%}"]
        rows.append((f"{ratio:g}", *(cell.replace("%", " %") for cell in cells)))
    return rows


def schemes(found: dict[str, Any]) -> Rows:
    """Largest stable steps of explicit schemes, and errors of mean and deviation at half that of the weaker one."""
    head = ("damping ratio", "largest stable step [s]: rk2", "semi-implicit Euler", "step [s]")
    rows = [(*head, "errors of mean, deviation: rk2", "semi-implicit Euler", f"energy_momentum at {USUAL:g} s")]
    for row in found["schemes"]:
        if "rk2" not in row:  # the free swing, which has no damping ratio
            continue
        both = [row["rk2"], row["semi_implicit_euler"]]
        largest = (f"{one['largest_stable_dt_s']:.1e}" for one in both)
        errors = [_pair(one["common"]) for one in both] + [_pair(row["energy_momentum"])]
        rows.append((f"{row['damping_ratio']:g}", *largest, f"{both[0]['common']['dt_s']:.1e}", *errors))
    return rows


def speed(found: dict[str, Any]) -> Rows:
    """Processor time per simulated second, errors, and how much faster at equal or smaller error."""
    head = ("", "rope law and scheme here", "MoorDyn [ms]", "errors of mean, deviation", "here, dt [s]", "[ms]")
    rows = [(*head, "errors of mean, deviation", "wanted", "as exact")]
    for row in found["speed"]:
        theirs, best = row["moordyn"], row["all_steps"]
        shown = USUAL if best is None else best["ours_dt_s"]
        ours = next(run for run in row["our_runs"] if abs(run["dt_s"] / shown - 1.0) < 1e-9)
        cells = (f"{row['law']}, {row['integrator']}", _milli(theirs["cpu_per_s"]), _pair(theirs["errors"]))
        cells += (f"{shown:.3g}", _milli(ours["cpu_per_s"]), _pair(ours["errors"]))
        rows.append((row["name"], *cells, f"{row['wanted']:g} times", _as_exact(row)))
    return rows


def peaks(found: dict[str, Any]) -> Rows:
    """Both codes at their cheapest step whose mean, deviation and window maxima are within the limits."""
    head = ("", "runs", "code", "step [s]", "[ms]", "errors of mean, deviation, window maxima", "of the reference")
    rows = [(*head, "mean of window maxima [N]", "MoorDyn's time over ours")]
    for row in found.get("peaks", []):
        for key, name in (("ours", "here"), ("moordyn", "MoorDyn v2")):
            code, shown = row[key], row[key]["best"]
            ratio = "" if key == "ours" or row["ratio"] is None else f"{row['ratio']:.1f}"
            errors = "none" if shown is None else _three(shown["errors"])
            step = "none" if shown is None else f"{shown['dt_s']:g}"
            if shown is not None and shown["tolerance"] is not None:
                step = f"up to {step}, tolerance {shown['tolerance']:g} m/s"
            cells = (
                step,
                "" if shown is None else _milli(shown["cpu_per_s"]),
                errors,
                _three(code["reference_errors"]),
            )
            rows.append((row["name"], str(row["runs"]), name, *cells, f"{code['reference']['peaks']:.0f}", ratio))
    return rows


def peak_steps(found: dict[str, Any]) -> Rows:
    """Errors of our steps in mean, deviation and window maxima."""
    rows = [("", "step [s]", "[ms]", "errors of mean, deviation, window maxima")]
    for row in found.get("peaks", []):
        for one in row["ours"]["steps"]:
            tolerance = "" if one["tolerance"] is None else f", tolerance {one['tolerance']:g} m/s"
            step = f"{'up to ' if tolerance else ''}{one['dt_s']:g}{tolerance}"
            rows.append((row["name"], step, _milli(one["cpu_per_s"]), _three(one["errors"])))
    return rows


def _three(errors: dict[str, float]) -> str:
    return ", ".join(f"{100 * errors[key]:.2g} %" for key in ("mean", "std", "peaks"))


def _as_exact(row: dict[str, Any]) -> str:
    """How fast at equal or smaller error, bold where that misses what was wanted."""
    whole, slow = row["all_steps"], row["below_5_hz"]
    text = "at no step tried" if whole is None else f"{_compared(whole)} (at {whole['ours_dt_s']:.2g} s)"
    if whole is None or whole["ratio"] < row["wanted"]:
        text = f"**{text}**"
    if slow is None or slow == whole:
        return text
    return f"{text}; {_compared(slow)} for means over 0.1 s (at {slow['ours_dt_s']:.2g} s)"


def _compared(found: dict[str, Any]) -> str:
    words = "times faster" if found["ratio"] >= 1.0 else "times as fast"
    return f"{found['ratio']:.2g} {words}"


def _pair(errors: dict[str, Any] | None) -> str:
    return "-" if errors is None else f"{errors['mean']:.1e}, {errors['std']:.1e}"


def _milli(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def _kilo(newton: float) -> str:
    return f"{newton / 1e3:.1f}"


def swing(found: dict[str, Any]) -> Rows:
    """How much energy a chain that swings freely, without water and damper, gains or loses with each scheme."""
    rows = [("scheme", "dt [s]", "largest change of energy over the kinetic energy at the start")]
    for row in next(row["released"] for row in found["schemes"] if "released" in row):
        change = "not finite" if row["largest"] is None else f"{row['largest']:.1e}"
        rows.append((row["scheme"], f"{row['dt_s']:g}", change))
    return rows


def rest(found: dict[str, Any]) -> Rows:
    """End tensions of packaged scenes at rest against MoorDyn's on their decks, or why they are not compared."""
    head = ("scenes", "lines", "largest tension [N]", "scene against MoorDyn", "its deck, as read here")
    rows, other = [(*head, "MoorDyn's nodes, at most [mm/s]")], dict[str, list[str]]()
    for row in found["rows"]:
        if row["status"] != "ok":
            other.setdefault(row["status"], []).append(row["scene"])
            continue
        differences = (f"{100 * row[key]:.2g} %" for key in ("scene_difference", "deck_difference"))
        fine = "" if row["links"] == 1 else f", {row['links']} times the links"
        rows.append((row["scene"], f"{row['lines']}{fine}", f"{row['largest_n']:.0f}", *differences, _speed(row)))
    return rows + [(", ".join(scenes), reason, "", "", "", "") for reason, scenes in other.items()]


def _speed(row: dict[str, Any]) -> str:
    return f"{1e3 * row['speed']:.1g}"


TABLES = {
    "moordyn_cases": cases,
    "moordyn_swing": swing,
    "moordyn_ratios": ratios,
    "moordyn_conventions": conventions,
    "moordyn_steps": steps,
    "moordyn_schemes": schemes,
    "moordyn_speed": speed,
    "moordyn_peaks": peaks,
    "moordyn_peak_steps": peak_steps,
}
