"""The tables of `docs/` and the README, written from measurements in `results/` so that nobody copies numbers by hand.

    python benchmarks/tables.py [--measure]

With --measure the measurements are made again first: `dropper stability`, `dropper accuracy dropper-north-sea --quick`
and `benchmarks/north_sea.py --effects`, about ten minutes. A table is in a document between the lines
`<!-- table: NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from study import RESULTS, Rows, columns, joined, markdown, stored

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
COMMANDS = {
    "stability": ["stability", "--json", "--quiet"],
    "accuracy_north_sea": ["accuracy", "dropper-north-sea", "--quick", "--json", "--quiet"],
}
#: Name of a table: results (`results/NAME.json`) that it is made of, and rows or Markdown made of them.
TABLES: dict[str, tuple[tuple[str, ...], Callable[..., Rows | str]]] = {}
Found = dict[str, Any]


def table_of(*results: str, name: str = "") -> Callable[[Callable[..., Rows | str]], Callable[..., Rows | str]]:
    """Enter a table of these results, by the name of its function unless given."""

    def entered(make: Callable[..., Rows | str]) -> Callable[..., Rows | str]:
        TABLES[name or make.__name__] = results, make
        return make

    return entered


# Cells


def _share(x: float, digits: int = 0) -> str:
    return f"{100 * x:.{digits}f} %"


def _kilo(newton: float) -> str:
    return f"{newton / 1e3:.1f}"


def _milli(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def _from_to(interval: list[float]) -> str:
    return f"{_kilo(interval[0])} to {_kilo(interval[1])}"


# Stability and accuracy

BASELINES = ("thesis_angles 0.51", "thesis_angles 0.5", "theta 0.51", "theta 0.5")
PEERS = ("moordyn rk2", "moordyn default")


def _baselines(row: Found) -> list[tuple[str, Callable[[Found], str]]]:
    return [(name, lambda row, name=name: _baseline((row["baseline_thesis"] or {}).get(name))) for name in BASELINES]


def _baseline(found: Found | None) -> str:
    if found is None:
        return "-"
    if found["status"] == "ok":
        share = found["energy_drift_share"]
        return ("wrong" if found["wrong_energy"] else "ok") + ("" if share is None else f", energy {share:.0e}")
    return f"{found['status']} at {found['failed_at_s']:.3g} s" if "failed_at_s" in found else found["status"]


@table_of("stability")
def stability(found: Found) -> Rows:
    return columns(
        found["cases"],
        ("case", "{name}"),
        ("claim", "{claim}"),
        ("measured", lambda r: "-" if r["measured"] is None else "{measured:.1e} {unit}".format(**r)),
        ("limit", "{limit:.0e}"),
        ("holds", lambda r: "yes" if r["ok"] else "**no**"),
        *_baselines(found),
    )


@table_of("stability")
def stability_peers(found: Found) -> Rows:
    """The cases that MoorDyn was given as well."""
    return columns(
        (row for row in found["cases"] if row.get("peers")),
        ("case", "{name}"),
        ("here", "{measured:.0e} {unit}"),
        ("limit", "{limit:.0e}"),
        *((label, lambda r, label=label: _peer(r["peers"][label])) for label in PEERS),
    )


def _peer(found: Found) -> str:
    if found["status"] != "ok":
        return f"{found['status']} at {found['failed_at_s']:.3g} s"
    return f"{'holds' if found['holds'] else 'wrong'}, {found['measured']:.0e}"


@table_of("stability")
def thesis(found: Found) -> Rows:
    """The cases that the thesis' schemes were run on as well."""
    ran = lambda row: any(x["status"] not in ("refused", "not_run") for x in (row["baseline_thesis"] or {}).values())  # noqa: E731
    ours = lambda r: r["status"] + ("" if r["unit"] == "-" else f", {r['measured']:.0e} {r['unit']}")  # noqa: E731
    return columns(filter(ran, found["cases"]), ("case", "{name}"), ("energy_momentum", ours), *_baselines(found))


@table_of("accuracy_north_sea")
def accuracy_north_sea(found: Found) -> str:
    def error(name: str) -> Callable[[Found], str]:
        return lambda row: "-" if row[name] is None else f"{row[name]:.1e}"

    rows = columns(
        found["rows"],
        ("scheme", "{label}"),
        ("dt [s]", "{dt:.4g}"),
        ("RMS angle [rad]", error("rms_angle_error_rad")),
        ("RMS position [m]", error("rms_position_error_m")),
        ("tension [N]", error("rms_tension_error_n")),
        ("status", "{status}"),
    )
    reference = found["reference"]
    text = ", ".join(f"{label} {order:.2f}" for label, order in found["orders"].items())
    return (
        f"{markdown(rows)}\n\nCompared over {reference['horizon_s']:.3g} s; reference: {reference['made_by']}, its own "
        f"error {reference['error_estimate_rad']:.1e} rad against {reference['checked_by']}. Measured orders: {text}."
    )


@table_of("long_steps")
def long_steps(found: Found) -> Rows:
    """Warnings of steps that are too long, by kind of check and group of scenes."""
    rows = [
        {"checked": words, "scenes": f"{len(found[group]['scenes'])} that it was {kind}", **found[group][mode]}
        for mode, words in (("whole", "the whole run"), ("stretches", "stretches"))
        for group, kind in (("tuned", "tuned on"), ("judged", "judged by"))
    ]
    return columns(
        rows,
        ("repeated", "{checked}"),
        ("scenes", "{scenes}"),
        ("wrong at 3 to 30 times the step", "{wrong}"),
        ("not warned of", lambda r: str(len(r["without_warning"]))),
        ("right at the step or half of it", "{right}"),
        ("warned of", lambda r: str(len(r["false_alarms"]))),
    )


@table_of("peers")
def peers(found: Found) -> Rows:
    """How many times faster than others at equal or smaller error, where that is least and where it is most."""

    def end(name: str) -> Callable[[Found], str]:
        def cell(goal: Found) -> str:
            ours, peer = (goal[name][key].split(",")[0] for key in ("ours", "peer"))
            return f"{goal[name]['ratio']:.2g} at {goal[name]['error_m']:.0e} m ({ours} against {peer})"

        return cell

    return columns(
        ({"scene": scene["scene"], **goal} for scene in found["scenes"] for goal in scene["goals"]),
        ("line", "{scene}"),
        ("against", "{goal}"),
        ("goal", "{wanted:g}"),
        ("minimum", end("least")),
        ("maximum", end("largest")),
        ("reached everywhere", lambda goal: "yes" if goal["met"] else "**no**"),
    )


@table_of("one_kernel")
def one_kernel(found: Found) -> Rows:
    return columns(
        found["rows"],
        ("run", "{case}"),
        ("launched one by one [us per step]", "{plain_us:.3g}"),
        ("one kernel", "{one_kernel_us:.3g}"),
        ("times faster", "{times_faster:.1f}"),
        ("compilation [s]", "{plain_compile_s:.1f}"),
        ("one kernel", "{one_kernel_compile_s:.1f}"),
    )


@table_of("convergence")
def convergence(found: Found) -> Rows:
    def load(name: str) -> Callable[[Found], str]:
        def cell(row: Found) -> str:
            agree = row[f"{name} agrees"]
            return f"{100 * row[name]:.2g} %" + ("" if agree == row["lines"] else f" ({agree} of {row['lines']})")

        return cell

    return columns(
        ({"scene": scene, **row} for scene, steps in found["scenes"].items() for row in steps),
        ("scene", "{scene}"),
        ("step [s]", "{dt:.3g}"),
        ("mean", load("mean")),
        ("deviation", load("deviation")),
        ("99.9 % in time", load("quantile")),
        ("mean of windows' maxima", load("window maximum")),
        ("largest", lambda r: f"{100 * r['largest']:.2g} %"),
    )


# Sweeps, sensitivity, reports, films


@table_of("sweep")
def sweep(found: Found) -> str:
    """Throughput of a sweep of the lab dropper, saving included."""
    rows = columns(
        found["rows"],
        ("cases", "{cases}"),
        ("steps of each", "{steps_per_case}"),
        ("until compiled [s]", "{compile_s:.1f}"),
        ("run and saved [s]", "{run_s:.2f}"),
        ("million steps per second", "{million_steps_per_s:.1f}"),
        ("memory at most [MB]", "{peak_memory_mb:.0f}"),
    )
    single, ratio = found["single_runs_million_steps_per_s"], found["times_faster_than_single_runs"]
    return (
        f"{markdown(rows)}\n\nOn {found['machine']['cores']} cores. A loop over single runs makes {single:.2g} million "
        f"steps per second: the sweep is {ratio:.0f} times as fast."
    )


@table_of("sweep_truths")
def sweep_truths(found: Found) -> str:
    """Where the true pair of Table E.1 is among the fifteen, by part and measure, and the fit of the same trace."""
    parts = ("head", "middle", "tail")

    def rank(part: str) -> Callable[[Found], str]:
        """The error, and the rank where it is not the first."""

        def cell(row: Found) -> str:
            angle = row[part]["angle"]
            return f"{1e3 * angle['true']:.2f}" + ("" if angle["rank"] == 1 else f" (rank {angle['rank']})")

        return cell

    def fitted(i: int) -> Callable[[Found], str]:
        def cell(row: Found) -> str:
            if not row.get("fit", {}).get("values"):
                return ("not fitted", "")[i]
            return f"{row['fit']['values'][i]:.4g} +- {row['fit']['std_errors'][i]:.1g}"

        return cell

    rows = columns(
        found["rows"],
        ("truth: b_l [kg/s], b_q [kg/m]", "{b_l:g}, {b_q:g}"),
        *((part, rank(part)) for part in parts),
        ("best other pair, head", lambda r: f"{1e3 * r['head']['angle']['other']:.2f}"),
        ("fitted b_l", fitted(0)),
        ("fitted b_q", fitted(1)),
    )
    first = lambda part, by: sum(row[part][by]["rank"] == 1 for row in found["rows"])  # noqa: E731
    words = ", ".join(
        f"{first(p, 'angle')} by the {p}'s angles ({first(p, 'spectrum')} by its spectrum)" for p in parts
    )
    return f"{markdown(rows)}\n\nOf {len(found['rows'])} truths the true pair is the best of the list in {words}."


@table_of("scene_sensitivity")
def scene_sensitivity(found: Found) -> str:
    """Exact derivatives of a tension to numbers of its scene, beside differences."""
    rows = columns(
        found["rows"],
        ("number of the scene", "`{path}`"),
        ("value", lambda r: "{value:.5g} {unit}".format(**r).removesuffix(" -")),
        ("derivative [N per unit]", "{derivative:.6g}"),
        ("by differences", "{differences:.6g}"),
        ("per cent for one per cent", "{scaled:.2g}"),
    )
    return (
        f"{markdown(rows)}\n\n`{found['of']}` of `{found['scene']}` is {found['value']:.1f} N; forward and reverse "
        f"mode differ by {found['modes_differ']:.0e}."
    )


@table_of("report_examples")
def report_damping(found: Found) -> str:
    """Loads and damage of a snapping chain by internal damping and step."""
    rows = columns(
        found["damping"],
        ("damping ratio", "{damping_ratio:g}"),
        ("step [s]", "{dt_s:g}"),
        ("mean anchor load [N]", "{mean_anchor_n:.0f}"),
        ("largest tension [kN]", lambda r: _kilo(r["largest_n"])),
        ("snaps, worst link", "{snaps}"),
        ("equivalent range [kN]", lambda r: _kilo(r["equivalent_range_n"])),
        ("damage per year", "{damage_per_year:.1f}"),
        ("steps retried", "{retried}"),
    )
    mean, largest, damage = (
        max(values) / min(values)
        for values in (
            [row[key] for row in found["damping"]] for key in ("mean_anchor_n", "largest_n", "damage_per_year")
        )
    )
    return (
        f"{markdown(rows)}\n\nThe mean load agrees within {_share(mean - 1, 1)}. The largest tension differs by a "
        f"factor of {largest:.1f} and the damage by {damage:.1f}, mostly with the step."
    )


@table_of("report_examples")
def report_storm(found: Found) -> str:
    """Extremes of a storm from several seeds."""
    kinds = {"most_probable": "most probable", "mean": "mean", "percentile_90": "90th percentile"}
    storm = found["storm"]
    rows = columns(
        storm["rows"],
        ("extrapolated to 3 h", "{what}"),
        ("largest of each run [kN]", lambda r: _from_to(r["maxima"])),
        *(
            (f"{word}, 90 % interval [kN]", lambda r, key=key: f"{_kilo(r[key][0])}, {_from_to(r[key][1:])}")
            for key, word in kinds.items()
        ),
    )
    return (
        f"{markdown(rows)}\n\nThe largest tension of {storm['further_seeds']} further seeds, which make up 3 h, is "
        f"{_kilo(storm['further_largest_n'])} kN. Steps retried in a run: at most {storm['retried']}."
    )


@table_of("films")
def films(found: Found) -> str:
    """Films of known motion, tracked with boards and without."""

    def if_known(form: str) -> Callable[[Found], str]:
        return lambda row: form.format(**row) if "rms_mrad" in row else "-"

    def order(row: Found) -> str:
        return "not known, exit 3" if "rms_mrad" not in row else "right" if row["right_order"] else "**wrong**"

    rows = columns(
        found["films"],
        ("film", "{film}"),
        ("boards", lambda r: "yes" if r["calibrated"] else "no"),
        ("order", order),
        ("RMS error [mrad]", if_known("{rms_mrad:.2f}")),
        ("maximum [mrad]", if_known("{largest_mrad:.1f}")),
        ("stated over true error", if_known("{stated_over_true:.2f}")),
        ("of each link", if_known("{of_links[0]:.2f} to {of_links[1]:.2f}")),
        ("left empty", lambda r: _share(r["empty_share"], 1) if "rms_mrad" in r else "-"),
        ("marked", lambda r: _share(r["marked_share"], 1) if "rms_mrad" in r else "-"),
    )
    total = {key: sum(row[key] for row in found["marks"]) for key in found["marks"][0] if key != "film"}
    share = lambda part, whole: _share(total[part] / total[whole], 1)  # noqa: E731
    return (
        f"{markdown(rows)}\n\nOf {total['swapped']} frames in which two nodes were made to swap names "
        f"{share('swapped_found', 'swapped')} are marked, of {total['jumped']} in which one was shifted by 0.2 to 1 "
        f"link {share('jumped_found', 'jumped')}, of {total['well']} others {share('well_marked', 'well')}."
    )


# Calibration


@table_of("random_droppers")
def random_droppers(found: Found) -> Rows:
    """Fits of random droppers: how many are right, and how good their errors are."""
    head = ("draws", "`ok`", "and explain their trace", "wrong", "noise within 10 %", "90 % intervals of b_l, b_q hold")
    lines = [(*head, "error over standard error, RMS")]
    for kind, rows in found.items():
        ok = [row for row in rows if row["status"] == "ok"]
        good = [r for r in ok if 0.95 <= r["residual"] / r["noise"] <= 1.05 and r["fitted"] >= 0.97]
        wrong = [r for r in ok if r["residual"] / r["noise"] > 1.4]
        printed = [r for r in rows if abs(r["printed_noise"] / r["noise"] - 1) < 0.1]
        inside, spread = [], []
        for i in range(2):
            inside.append(np.mean([r["low"][i] <= r["truth"][i] <= r["high"][i] for r in ok]))
            sharp = [r for r in ok if not r["at_bound"][i] and r["std_error"][i] < 0.5 * r["values"][i]]
            off = [(r["values"][i] - r["truth"][i]) / r["std_error"][i] for r in sharp]
            spread.append(np.sqrt(np.mean(np.square(off))))
        counts = (str(len(part)) for part in (ok, good, wrong, printed))
        lines.append((f"{len(rows)}, {kind}", *counts, joined(inside, "{:.0%}"), joined(spread, "{:.2f}")))
    return lines


@table_of("descent")
def descent(found: Found) -> Rows:
    """Gradient descent beside Gauss-Newton."""

    def value(i: int) -> Callable[[Found], str]:
        return lambda row: f"{row['values'][i]:.6f} +- {row['std_errors'][i]:.6f}"

    def off(row: Found) -> str:
        departures = zip(row["values"], found["truth"], row["std_errors"], strict=True)
        return joined([(v - t) / e for v, t, e in departures], "{:+.2f}")

    rows = columns(
        found["rows"],
        ("method", "{method}"),
        ("evaluations", "{evaluations}"),
        ("processor [s]", "{processor_s:.1f}"),
        ("b_l [kg/s]", value(0)),
        ("b_q [kg/m]", value(1)),
        ("off by [standard errors]", off),
    )
    return [*rows, ("truth", "", "", *(f"{value:g}" for value in found["truth"]), "")]


@table_of("measured_single_pendulum", "measured_double_pendulum")
def calibration_held_out(single: Found, double: Found) -> Rows:
    """Errors on the held-out windows of both rigs [mrad]."""
    return columns(
        ({"rig": rig, **found} for rig, found in (("single", single), ("double", double))),
        ("rig", "{rig}"),
        ("held out [s]", lambda r: f"{r['held_out_s'][0][0]:g} to {r['held_out_s'][-1][1]:g}"),
        ("published [mrad]", lambda r: joined([1e3 * x for x in r["published_rad"]], "{:.2g}")),
        ("fitted [mrad]", lambda r: joined([1e3 * x for x in r["held_out_rad"]], "{:.2g}")),
        ("ratio of means", "{ratio_of_means:.2f}"),
    )


@table_of("calibration_twin", "calibration_coverage", "calibration_dry")
def calibration_twins(twin: Found, coverage: Found, dry: Found) -> Rows:
    """Twin experiments: how many converge, errors over standard errors, cover, and how large the errors are."""
    twins = {"linear + quadratic": twin, "60 draws": coverage}
    twins |= {f"dry friction, {links}": found for links, found in dry.items()}
    return columns(
        (
            {"twin": title, "method": method, **methods[method]}
            for title, methods in twins.items()
            for method in ("windows", "shooting")
            if method in methods
        ),
        ("synthetic data", "{twin}"),
        ("method", "{method}"),
        ("converged", "{converged} of {fits}"),
        ("RMS of error/std error", lambda r: joined(r["z_rms"], "{:.2f}")),
        ("90 % intervals cover", lambda r: joined([100 * x for x in r["covered_90"]], "{:.0f} %")),
        ("median std error", lambda r: joined([100 * x for x in r["median_relative_std_error"]], "{:.2g} %")),
    )


@table_of("measured_single_pendulum", name="calibration_laws_single")
@table_of("measured_double_pendulum", name="calibration_laws_double")
def calibration_laws(found: Found) -> Rows:
    """Damping laws of one rig on windows before the held-out part."""
    laws = found["laws_on_windows_before_the_held_out_part"]
    least = min(law["bic"] for law in laws)
    return columns(
        laws,
        ("law", "{name}"),
        ("coefficients", "{coefficients}"),
        ("fitted [mrad]", lambda r: f"{1e3 * r['rms']:.3g}"),
        ("not fitted [mrad]", lambda r: f"{1e3 * r['held_out']:.3g}"),
        ("BIC - minimum", lambda r: f"{r['bic'] - least:.0f}"),
        ("", lambda r: "simplest within one standard error" if r["chosen"] else r["status"].replace("ok", "")),
    )


#: Damping of the traces of `spoilers.py`, both coefficients.
SPOILED_TRUTH = 4e-3


@table_of("spoilers")
def spoilers(rows: list[Found]) -> Rows:
    """What was named first, how often intervals cover, errors against their bound."""
    clean = np.median([row["std_error"] for row in rows if row["spoiler"] == "clean"], axis=0)

    def judged(kind: str) -> Found:
        some = [row for row in rows if row["spoiler"] == kind]
        value, se, low, high, bound = (
            np.array([row[key] for row in some], float) for key in ("values", "std_error", "low", "high", "bound")
        )
        return {
            "spoiler": kind,
            "draws": len(some),
            "named": sum(_rightly_named(row) for row in some),
            "cover": ((low <= SPOILED_TRUTH) & (high >= SPOILED_TRUTH)).sum(axis=0),
            "z": np.sqrt(np.mean(((value - SPOILED_TRUTH) / se) ** 2, axis=0)),
            "ratio": se / bound,
            "over_clean": np.median(se / clean),
        }

    return columns(
        map(judged, dict.fromkeys(row["spoiler"] for row in rows)),
        ("systematic error", "{spoiler}"),
        ("draws", "{draws}"),
        ("right name first", "{named}"),
        ("cover b_l, b_q", "{cover[0]}, {cover[1]}"),
        ("RMS error/SE", "{z[0]:.2f}, {z[1]:.2f}"),
        ("SE/bound", lambda r: f"{np.nanmedian(r['ratio']):.2f}"),
        ("maximum", lambda r: f"{np.nanmax(r['ratio']):.2f}"),
        ("SE/clean", "{over_clean:.2f}"),
    )


@table_of("spoilers")
def spoilers_named(rows: list[Found]) -> Rows:
    """What was named first, by the truth."""
    names = list(dict.fromkeys(_kind_of(row["first"]) for row in rows))
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        counts.setdefault(row["spoiler"], Counter())[_kind_of(row["first"])] += 1
    return [("truth", *names), *((kind, *(str(c[name] or "") for name in names)) for kind, c in counts.items())]


def _kind_of(name: str) -> str:
    """A first name without its numbers."""
    if "lost frames" in name:
        return "lost frames"
    return re.sub(r" (\d|\(.*\))", "", name).replace("place of", "position of") or "nothing"


def _rightly_named(row: Found) -> bool:
    """Whether the first name is the spoiler, its link or node as well."""
    if row["spoiler"] == "lengths and roll":
        return all(any(part in name for name in row["names"]) for part in ("lengths", "roll"))
    if row["truth"] in ("outliers", "lost frames"):
        return _kind_of(row["first"]) == row["truth"]
    return row["first"].split(" or ")[0] == row["truth"]


#: Cases of `channels.py` in words, by their place in the results.
CHANNELS = {
    ("sea", "taut"): "longline, taut ropes",
    ("sea", "slack"): "longline, slack ropes",
    ("sea", "stiff"): "longline, slack and stiff",
    ("cable", "stiff"): "cable, markers on every node",
    ("cable", "limp"): "limp cable, one marker",
    ("runs",): "five releases, damping differs by 5 %",
    ("cameras",): "kicked chain, two cameras",
}


@table_of("channels")
def channels(found: Found) -> Rows:
    rows = []
    for place, words in CHANNELS.items():
        case = found
        for key in place:
            case = case.get(key, {})
        more = {"case": words, "draws": case.get("draws")}
        rows += [{**more, "name": name.removeprefix("effects."), **r} for name, r in case.get("parameters", {}).items()]
    verdicts = {"not_determined": "not determined", "upper_bound": "upper bound"}
    error = lambda x: "-" if x is None else f"{100 * x:.2g} %"  # noqa: E731
    return columns(
        rows,
        ("case", "{case}"),
        ("parameter", "`{name}`"),
        ("draws", "{draws}"),
        ("90 % intervals cover", "{cover}"),
        ("RMS of error/std error", "{rms_of_error_over_std_error:.2f}"),
        ("median std error", lambda r: error(r["median_relative_error"])),
        ("verdict", lambda r: ", ".join(f"{words} in {r[key]}" for key, words in verdicts.items() if r[key])),
    )


# MoorDyn

#: The step of ours that the speed table shows where none is as exact as MoorDyn [s].
USUAL = 0.02
CODES = (("ours", "here"), ("moordyn", "MoorDyn v2"))


@table_of("moordyn")
def moordyn_cases(found: Found) -> Rows:
    """Motion of the buoy and mean tensions of the paper's cases in both codes, at the ratio of 0.1."""

    def ends(name: str) -> Callable[[Found], str]:
        return lambda r: f"{r['whole'][name]['mean']:.0f} / {r['settled'][name]['mean']:.0f}"

    def between(axis: int, digits: int) -> Callable[[Found], str]:
        return lambda r: " to ".join(f"{r['whole']['place'][key][axis]:.{digits}f}" for key in ("min", "max"))

    return columns(
        (
            {"case": case["case"], "code": name, **case[code]}
            for case in found["cases"]
            if case["damping_ratio"] == 0.1
            for code, name in CODES
        ),
        ("case", "{case}"),
        ("code", "{code}"),
        ("buoy, range along the waves [m]", between(0, 1)),
        ("range of z [m]", between(2, 2)),
        ("mean anchor [N], whole / after 50 s", ends("anchor")),
        ("mean fairlead [N]", ends("fairlead")),
        ("largest, anchor [kN]", lambda r: _kilo(r["whole"]["anchor"]["max"])),
    )


@table_of("moordyn")
def moordyn_ratios(found: Found) -> Rows:
    """Case 1 at several internal damping ratios: mean, least and largest anchor tension in both codes."""
    return columns(
        (
            {"ratio": case["damping_ratio"], "code": name, **case[code]["settled"]["anchor"]}
            for case in found["cases"]
            if case["case"] == 1
            for code, name in CODES
        ),
        ("damping ratio", "{ratio:g}"),
        ("code", "{code}"),
        ("mean anchor after 50 s [N]", "{mean:.0f}"),
        ("least [kN]", lambda r: _kilo(r["min"])),
        ("largest [kN]", lambda r: _kilo(r["max"])),
    )


@table_of("moordyn")
def moordyn_conventions(found: Found) -> Rows:
    """Static anchor tension of case 4 by conventions."""
    return columns(found["case_4"], ("case 4", "{convention}"), ("anchor tension [N]", "{anchor_n:.1f}"))


@table_of("moordyn")
def moordyn_steps(found: Found) -> Rows:
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


@table_of("moordyn")
def moordyn_schemes(found: Found) -> Rows:
    """Largest stable steps of explicit schemes, and errors of mean and deviation at half that of the weaker one."""
    return columns(
        (row for row in found["schemes"] if "rk2" in row),  # the free swing has no damping ratio
        ("damping ratio", "{damping_ratio:g}"),
        ("largest stable step [s]: rk2", "{rk2[largest_stable_dt_s]:.1e}"),
        ("semi-implicit Euler", "{semi_implicit_euler[largest_stable_dt_s]:.1e}"),
        ("step [s]", "{rk2[common][dt_s]:.1e}"),
        ("errors of mean, deviation: rk2", lambda r: _pair(r["rk2"]["common"])),
        ("semi-implicit Euler", lambda r: _pair(r["semi_implicit_euler"]["common"])),
        (f"energy_momentum at {USUAL:g} s", lambda r: _pair(r["energy_momentum"])),
    )


@table_of("moordyn")
def moordyn_swing(found: Found) -> Rows:
    """How much energy a chain that swings freely, without water and damper, gains or loses with each scheme."""
    return columns(
        next(row["released"] for row in found["schemes"] if "released" in row),
        ("scheme", "{scheme}"),
        ("dt [s]", "{dt_s:g}"),
        (
            "largest change of energy over the kinetic energy at the start",
            lambda r: "not finite" if r["largest"] is None else f"{r['largest']:.1e}",
        ),
    )


@table_of("moordyn")
def moordyn_speed(found: Found) -> Rows:
    """Processor time per simulated second, errors, and how much faster at equal or smaller error."""

    def ours(row: Found) -> Found:
        shown = USUAL if row["all_steps"] is None else row["all_steps"]["ours_dt_s"]
        return {"shown": shown, **next(run for run in row["our_runs"] if abs(run["dt_s"] / shown - 1.0) < 1e-9)}

    return columns(
        ({**row, "ours": ours(row)} for row in found["speed"]),
        ("", "{name}"),
        ("rope law and scheme here", "{law}, {integrator}"),
        ("MoorDyn [ms]", lambda r: _milli(r["moordyn"]["cpu_per_s"])),
        ("errors of mean, deviation", lambda r: _pair(r["moordyn"]["errors"])),
        ("here, dt [s]", "{ours[shown]:.3g}"),
        ("[ms]", lambda r: _milli(r["ours"]["cpu_per_s"])),
        ("errors of mean, deviation", lambda r: _pair(r["ours"]["errors"])),
        ("goal", "{wanted:g} times"),
        ("as exact", _as_exact),
    )


def _as_exact(row: Found) -> str:
    """How fast at equal or smaller error, bold where that misses what was wanted."""
    whole, slow = row["all_steps"], row["below_5_hz"]
    text = "at no step tried" if whole is None else f"{_compared(whole)} (at {whole['ours_dt_s']:.2g} s)"
    if whole is None or whole["ratio"] < row["wanted"]:
        text = f"**{text}**"
    if slow is None or slow == whole:
        return text
    return f"{text}; {_compared(slow)} for means over 0.1 s (at {slow['ours_dt_s']:.2g} s)"


def _compared(found: Found) -> str:
    words = "times faster" if found["ratio"] >= 1.0 else "times as fast"
    return f"{found['ratio']:.2g} {words}"


def _pair(errors: Found | None) -> str:
    return "-" if errors is None else f"{errors['mean']:.1e}, {errors['std']:.1e}"


@table_of("moordyn")
def moordyn_peaks(found: Found) -> Rows:
    """Both codes at their cheapest step whose mean, deviation and window maxima are within the limits."""
    return columns(
        (
            {"code": name, "key": key, "best": row[key]["best"], **row, "own": row[key]}
            for row in found.get("peaks", [])
            for key, name in CODES
        ),
        ("", "{name}"),
        ("runs", "{runs}"),
        ("code", "{code}"),
        ("step [s]", lambda r: "none" if r["best"] is None else _step(r["best"])),
        ("[ms]", lambda r: "" if r["best"] is None else _milli(r["best"]["cpu_per_s"])),
        (
            "errors of mean, deviation, window maxima",
            lambda r: "none" if r["best"] is None else _errors(r["best"]["errors"]),
        ),
        ("of the reference", lambda r: _errors(r["own"]["reference_errors"])),
        ("mean of window maxima [N]", "{own[reference][peaks]:.0f}"),
        ("MoorDyn's time over ours", lambda r: "" if r["key"] == "ours" or not r["ratio"] else f"{r['ratio']:.1f}"),
    )


@table_of("moordyn")
def moordyn_peak_steps(found: Found) -> Rows:
    """Errors of our steps in mean, deviation and window maxima."""
    return columns(
        ({"name": row["name"], **one} for row in found.get("peaks", []) for one in row["ours"]["steps"]),
        ("", "{name}"),
        ("step [s]", _step),
        ("[ms]", lambda r: _milli(r["cpu_per_s"])),
        ("errors of mean, deviation, window maxima", lambda r: _errors(r["errors"])),
    )


def _step(row: Found) -> str:
    held = row["tolerance"] is not None
    return f"up to {row['dt_s']:g}, tolerance {row['tolerance']:g} m/s" if held else f"{row['dt_s']:g}"


def _errors(errors: dict[str, float]) -> str:
    return joined([100 * errors[key] for key in ("mean", "std", "peaks")], "{:.2g} %")


@table_of("moordyn_rest")
def moordyn_rest(found: Found) -> Rows:
    """End tensions of packaged scenes at rest against MoorDyn's on their decks, or why they are not compared."""
    other: dict[str, list[str]] = {}
    for row in found["rows"]:
        if row["status"] != "ok":
            other.setdefault(row["status"], []).append(row["scene"])
    rows = columns(
        (row for row in found["rows"] if row["status"] == "ok"),
        ("scenes", "{scene}"),
        ("lines", lambda r: f"{r['lines']}" + ("" if r["links"] == 1 else f", {r['links']} times the links")),
        ("largest tension [N]", "{largest_n:.0f}"),
        ("scene against MoorDyn", lambda r: f"{100 * r['scene_difference']:.2g} %"),
        ("its deck, as read here", lambda r: f"{100 * r['deck_difference']:.2g} %"),
        ("MoorDyn's nodes, at most [mm/s]", lambda r: f"{1e3 * r['speed']:.1g}"),
    )
    return rows + [(", ".join(scenes), reason, "", "", "", "") for reason, scenes in other.items()]


# The paper

PAPER = (("orcaflex", "OrcaFlex"), ("adapted_moordyn", "adapted MoorDyn"))
NUMBERS = (1, 2, 3, 4, 5)
#: Deviation [m] below which a motion is left out.
UNMOVED = 0.01


@table_of("table7")
def table7_cases(found: Found) -> Rows:
    """Least, mean and largest tension at both ends, the start included."""
    rows = [("case", "code", "anchor: least [N]", "mean", "largest", "fairlead: least [N]", "mean", "largest")]
    for number in NUMBERS:
        here, name = _span(found, number), str(number)
        rows.append((name, "here", *_three(here["anchor"]), *_three(here["fairlead"])))
        rows.append((name, "here, force on the end node", *_three(here["anchor_node"]), "-", "-", "-"))
        for row in found["moordyn"]:
            if row["case"] == number and row["damping_ratio"] > 0.0:
                code = f"MoorDyn v2, damping ratio {row['damping_ratio']:g}"
                ends = (row[end]["size"] if row["status"] == "ok" else None for end in ("anchor", "fairlead"))
                rows.append((name, code, *(cell for end in ends for cell in _three(end))))
        for key, code in PAPER:
            paper = (f"{value:.0f}" for value in found["table_7"][name][key])
            rows.append((name, f"Table 7: {code}", *paper, "-", "-", "-"))
    return rows


@table_of("table7")
def table7_lengths(found: Found) -> Rows:
    """Mean anchor tension by length of the record."""
    spans = [span["span_s"] for span in found["cases"][0]["spans"]]
    head = [f"first {span:g} s" for span in spans]
    rows = [("case", *head, "from 50 to 150 s", *(f"Table 7: {code}" for _, code in PAPER))]
    for row in found["cases"]:
        means = [span["anchor"]["mean"] for span in row["spans"]]
        settled = (means[spans.index(150.0)] * 150.0 - means[spans.index(50.0)] * 50.0) / 100.0
        error = _span(found, row["case"])["standard_error"]
        paper = (f"{found['table_7'][str(row['case'])][key][1]:.0f}" for key, _ in PAPER)
        rows.append((str(row["case"]), *(f"{mean:.0f}" for mean in means), f"{settled:.0f} ± {error:.0f}", *paper))
    return rows


@table_of("table7")
def table7_conventions(found: Found) -> Rows:
    """By how much one change moves the mean anchor tension of each case."""
    base = {number: _span(found, number) for number in NUMBERS}
    mean = {number: base[number]["anchor"]["mean"] for number in NUMBERS}
    rows = [("one change", *(f"case {number}, mean [N]" for number in NUMBERS), "case 4, largest [N]")]
    largest = f"{base[4]['anchor']['max']:.0f}"
    rows.append(("none: from Table 6, 150 s", *(f"{mean[n]:.0f}" for n in NUMBERS), largest))
    for name in dict.fromkeys(row["convention"] for row in found["conventions"]):
        own = {row["case"]: row for row in found["conventions"] if row["convention"] == name}
        cells = ["-" if n not in own else _moved(own[n], mean[n]) for n in NUMBERS]
        spans = own[4]["spans"] if 4 in own else []
        rows.append((name, *cells, f"{spans[0]['anchor']['max']:.0f}" if spans else "-"))
    node = (f"{base[n]['anchor_node']['mean'] - mean[n]:+.0f}" for n in NUMBERS)
    rows.append(("force on the anchor's node, not tension of its link", *node, f"{base[4]['anchor_node']['max']:.0f}"))
    for ratio in dict.fromkeys(row["damping_ratio"] for row in found["moordyn"]):
        own = {row["case"]: row for row in found["moordyn"] if row["damping_ratio"] == ratio}
        for size, word in ((False, ""), (True, ", pushing counted as pulling")):
            cells = [_other(own[n], mean[n], size) for n in NUMBERS]
            top = f"{own[4]['anchor']['max']:.0f}" if own[4]["status"] == "ok" else "-"
            rows.append((f"MoorDyn v2, damping ratio {ratio:g}{word}", *cells, top))
    for key, code in PAPER:
        paper = {n: found["table_7"][str(n)][key] for n in NUMBERS}
        rows.append((f"Table 7: {code}", *(f"{paper[n][1] - mean[n]:+.0f}" for n in NUMBERS), f"{paper[4][2]:.0f}"))
    for span in (50.0, 200.0):
        own = {n: _span(found, n, span)["anchor"] for n in NUMBERS}
        cells = (f"{own[n]['mean'] - mean[n]:+.0f}" for n in NUMBERS)
        rows.append((f"{span:g} s instead of 150 s", *cells, f"{own[4]['max']:.0f}"))
    errors = (f"± {base[n]['standard_error']:.0f}" for n in NUMBERS)
    return [*rows, ("chance (batch means, 50 to 150 s)", *errors, "-")]


def _span(found: Found, number: int, length: float | None = None) -> Found:
    """A case over a length of the record, that which is compared unless given."""
    row = next(row for row in found["cases"] if row["case"] == number)
    return next(span for span in row["spans"] if span["span_s"] == (length or found["span_s"]))


def _three(values: dict[str, float] | None) -> tuple[str, ...]:
    if values is None:
        return ("-", "-", "-")
    return tuple(f"{values[key] + 0.0:.0f}".replace("-0", "0") for key in ("min", "mean", "max"))


def _moved(row: Found, mean: float) -> str:
    return f"{row['spans'][0]['anchor']['mean'] - mean:+.0f}" if row["spans"] else row["status"].split(" ")[0]


def _other(row: Found, mean: float, size: bool) -> str:
    if row["status"] != "ok":
        return row["status"]
    return f"{(row['anchor']['size'] if size else row['anchor'])['mean'] - mean:+.0f}"


@table_of("table7")
def table7_edulis(found: Found) -> Rows:
    """Edulis in both codes."""

    def number(row: Found, value: float | None) -> str:
        force = row["mean"]["here"] > 100.0
        return "-" if value is None else f"{value:.0f}" if force else f"{value:.2f}"

    def here(what: str) -> Callable[[Found], str]:
        def cell(row: Found) -> str:
            one = row[what]
            value, error, chance = (number(row, x) for x in (one["here"], one["step"] + one["links"], one["chance"]))
            return f"{value} ± {error} ({chance})"

        return cell

    def there(what: str) -> Callable[[Found], str]:
        return lambda r: f"{number(r, r[what]['moordyn'])} ± {number(r, r[what]['moordyn_step'])}"

    return columns(
        (row for row in found["edulis"]["rows"] if row["deviation"]["here"] >= UNMOVED),
        ("", lambda r: f"{r['name']} {'[N]' if r['mean']['here'] > 100.0 else '[m]'}"),
        ("mean, here", here("mean")),
        ("mean, MoorDyn v2", there("mean")),
        ("deviation, here", here("deviation")),
        ("deviation, MoorDyn v2", there("deviation")),
        ("largest, here / MoorDyn v2", lambda r: f"{number(r, r['max']['here'])} / {number(r, r['max']['moordyn'])}"),
    )


@table_of("table7_peaks")
def table7_peaks(found: Found) -> Rows:
    """Largest anchor tension by scheme and step, the range over moved starts, and the paper's two codes."""
    schemes = list(dict.fromkeys(row["scheme"] for row in found["rows"]))
    kilo = lambda newton: f"{1e-3 * newton:.1f}" if newton >= 1e4 else f"{1e-3 * newton:.2f}"  # noqa: E731

    def at(scheme: str) -> Callable[[Found], str]:
        def cell(case: Found) -> str:
            own = (r for r in case["runs"] if r["moved_m"] == 0.0 and r["scheme"] == scheme)
            return ", ".join(f"{kilo(r['anchor']['max'])} ({1e3 * r['dt_s']:.3g})" for r in own) or "-"

        return cell

    def moved(case: Found) -> str:
        tops = [r["anchor"]["max"] for r in case["runs"] if r["moved_m"] != 0.0]
        return f"{kilo(min(tops))} to {kilo(max(tops))} ({len(tops)})" if tops else "-"

    good = [row for row in found["rows"] if row["status"] == "ok"]
    return columns(
        ({"case": n, "runs": [row for row in good if row["case"] == n]} for n in NUMBERS),
        ("case", "{case}"),
        *((f"{scheme} [kN] (step [ms])", at(scheme)) for scheme in schemes),
        ("starts moved by up to 1e-6 m [kN]", moved),
        *(
            (f"Table 7: {code} [kN]", lambda r, key=key: kilo(found["table_7"][str(r["case"])][key][2]))
            for key, code in PAPER
        ),
    )


@table_of("edulis_anchors")
def edulis_anchors(found: Found) -> Rows:
    """Edulis' anchors by heading of the tide."""

    def load(name: str) -> Callable[[Found], str]:
        return lambda r: f"{1e-3 * r['largest_load_n'][name]:.2f} ({100 * r['utilisation'][name]:.1f})"

    names = found["rows"][0]["largest_load_n"]
    anchors = ((f"{name} [kN] ([%])", load(name)) for name in names)
    return columns(found["rows"], ("heading [deg]", "{heading_deg}"), *anchors, ("moved [m]", "{moved_m:.1f}"))


@table_of("pitching")
def pitching(found: Found) -> Rows:
    """The paper's cases 1 to 3, upright and pitching, and case 1 without drag across the spar."""
    motion = lambda values: "{mean:.2f} / {std:.2f}".format(**values)  # noqa: E731
    return columns(
        (
            {**row, "note": note}
            for group, note in (("cases", ""), ("without_drag", ", no drag across"))
            for row in found[group]
        ),
        ("case", lambda r: r["case"].removeprefix("paper-case-")),
        ("spar", "{form}{note}"),
        ("anchor, mean / deviation / 99 % / largest [N]", lambda r: _load(r, "anchor")),
        ("at the spar [N]", lambda r: _load(r, "buoy")),
        ("surge, mean / deviation [m]", lambda r: motion(r["away_m"])),
        ("heave of the base [m]", lambda r: motion(r["heave_m"])),
        ("tilt, mean / deviation / largest [deg]", _tilt),
    )


@table_of("pitching")
def pitching_centres(found: Found) -> Rows:
    """Case 1 over the height of the centre of gravity."""
    period = lambda seconds: "it lies" if seconds is None else f"{seconds:.1f}"  # noqa: E731
    return columns(
        found["centres"],
        (
            "centre of gravity above the base [m]",
            lambda r: f"{r['centre_m']:.4g}" + (" (homogeneous)" if r["centre_m"] > 4.0 else ""),
        ),
        ("natural period of pitch in calm water [s]", lambda r: period(r["pitch_period_s"])),
        ("tilt, mean / deviation / largest [deg]", _tilt),
        ("anchor, mean / deviation / 99 % / largest [N]", lambda r: _load(r, "anchor")),
        ("beyond 60 degrees [% of time]", lambda r: f"{100 * r['capsized_share']:.0f}"),
    )


def _load(row: Found, end: str) -> str:
    load = row[f"{end}_n"]
    return joined((load["mean"], load["std"], row[f"{end}_99_n"], load["max"]), "{:.0f}", " / ")


def _tilt(row: Found) -> str:
    return "{mean:.0f} / {std:.0f} / {max:.0f}".format(**row["tilt_deg"]) if "tilt_deg" in row else "upright"


# Sources, the thesis, the sea


@table_of("sources")
def sources_thesis(found: Found) -> Rows:
    return [("table", "there", "here", "why"), *found["thesis"]]


@table_of("sources")
def sources_paper(found: Found) -> Rows:
    return [("table", "there", "here", "why"), *found["paper"]]


@table_of("sources")
def sources_figures(found: Found) -> Rows:
    return [("figure", "shows", "scenes", ""), *found["figures"]]


@table_of("thesis_release")
def thesis_release(found: Found) -> Rows:
    """Scenarios from the thesis' ramp and from their packaged poses, by the default scheme and by the thesis' own."""
    dampings = [(row["b_l"], row["b_q"]) for row in found["scenarios"][0]["ramp"]["thesis_angles"]]
    starts = (("ramp", "force until 15 s"), ("pose", "packaged pose"))
    ended = "{status}, {reached_s:.2f} s"
    return columns(
        (
            {"start": f"{row['scenario']}, {words}", **row[start]}
            for row in found["scenarios"]
            for start, words in starts
        ),
        ("scenario, start", "{start}"),
        (
            "angles before the release, RMS to the thesis' model [rad]",
            lambda r: "{rms_to_model_rad:.3f}".format(**r) if "rms_to_model_rad" in r else "no angles given",
        ),
        ("energy_momentum", lambda r: ended.format(**r["default"])),
        *(
            (f"thesis_angles, b_l {b_l:g} kg/s, b_q {b_q:g} kg/m", lambda r, i=i: ended.format(**r["thesis_angles"][i]))
            for i, (b_l, b_q) in enumerate(dampings)
        ),
    )


@table_of("thesis_release")
def thesis_dampings(found: Found) -> str:
    """Scenario A by the thesis' scheme with its dampings, and how far its equations run in a code of their own."""
    rows = columns(
        found["dampings"],
        ("b_l [kg/s]", "{b_l:g}"),
        ("b_q [kg/m]", "{b_q:g}"),
        ("in Table E.1", lambda r: "yes" if r["table_e_1"] else "no"),
        ("ends", "{status}"),
        ("after [s]", "{reached_s:.2f}"),
        ("energy not accounted for", lambda r: _share(r["energy_share"], 0 if r["energy_share"] >= 0.1 else 1)),
    )
    ran = "; ".join(
        "at {dt_s:g} s corrected to {corrected:.3f} s, as printed to {printed:.3f} s".format(**row)
        for row in found["independent"]
    )
    return f"{markdown(rows)}\n\nIn NumPy (C.32)-(C.41) in the plane run, undamped, {ran}."


@table_of("north_sea")
def north_sea(found: Found) -> Rows:
    """Angles, tensions and speeds of the dropper in the North Sea, effect by effect."""

    def between(key: str, digits: int = 2) -> Callable[[Found], str]:
        """The value of several runs where they agree to the digits that are printed, else from the least on."""

        def cell(row: Found) -> str:
            values = [run[key] for run in row["runs"]]
            if None in values:
                return "-"
            return " to ".join(dict.fromkeys(f"{value:.{digits}f}" for value in (min(values), max(values))))

        return cell

    def ended(row: Found) -> str:
        early = "{status} after {duration_s:.2f} s"
        return ", ".join(sorted({"ok" if r["status"] == "ok" else early.format(**r) for r in row["runs"]}))

    return columns(
        found["rows"],
        ("effects", "{name}"),
        ("minimum polar [rad]", between("polar_min_rad")),
        ("maximum", between("polar_max_rad")),
        ("maximum azimuth [rad]", between("azimuth_max_rad")),
        ("peak [Hz]", between("azimuth_peak_hz")),
        ("first link at most [N]", between("tension_first_max_n", 0)),
        ("last", between("tension_last_max_n", 0)),
        ("minimum [N]", between("tension_min_n", 0)),
        ("fastest [m/s]", between("speed_max_m_s", 1)),
        ("status", ended),
    )


@table_of("farm_wakes")
def farm_wakes(found: Found) -> Rows:
    """The farm of Plew et al. (2005) over the ropes per metre, which are not stated."""
    return columns(
        (*found["rows"], *found["others"]),
        ("ropes per metre of longline", "{ropes_per_m:g}"),
        ("crop rope [km]", "{crop_rope_km:.0f}"),
        ("depth [m], turbulence", "{depth_m:g}, {turbulence:g}"),
        ("reduced within, mean / largest", "{reduction_mean:.0%} / {reduction_max:.0%}"),
        ("beneath", "{reduction_beneath:.0%}"),
        ("Plew (2011), endless canopy", "{plew_2011:.0%}"),
        ("balance", "{balance:.2f}"),
    )


@table_of("farm_wakes")
def cylinder_wake(found: Found) -> Rows:
    """One cylinder, 420 diameters behind it."""
    width, defect = found["cylinder"]["half_width_over_d"], found["cylinder"]["defect_over_u"]

    def against(name: str, wanted: float, ours: float, form: str) -> tuple[str, ...]:
        return name, format(wanted, form), format(ours, form), f"{ours / wanted - 1.0:+.0%}"

    words = "defect over U, from the measured width and C_D = 1"
    return [
        ("420 d behind a cylinder", "measured", "here", "difference"),
        against("half-width over d", width["measured"], width["ours"], ".2f"),
        against(words, defect["from_measured_width"], defect["ours"], ".4f"),
    ]


# Writing


def measure() -> None:
    """Make the measurements again."""
    for name, arguments in COMMANDS.items():
        call = "import sys; from dropper_jax.cli import main; sys.exit(main(sys.argv[1:]))"
        done = subprocess.run([sys.executable, "-c", call, *arguments], stdout=subprocess.PIPE, text=True, check=False)
        (RESULTS / f"{name}.json").write_text(done.stdout)  # a case beyond its limit is a row like the others
    subprocess.run([sys.executable, HERE / "north_sea.py", "--effects"], check=True)


def filled(text: str) -> str:
    """A document with the tables that it asks for."""
    for name in re.findall(r"<!-- table: (\w+) -->", text):
        results, make = TABLES[name]
        table = make(*(stored(result) for result in results))
        table = table if isinstance(table, str) else markdown(table)
        place = re.compile(rf"(<!-- table: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = place.sub(lambda found, table=table: f"{found[1]}\n{table}\n\n{found[2]}", text)
    return text


def documents() -> list[Path]:
    """The README and the pages of `docs/`."""
    return [HERE.parent / "README.md", *sorted(DOCS.glob("*.md"))]


def write() -> None:
    """Put the tables into the documents that ask for them."""
    for document in documents():
        document.write_text(filled(document.read_text()))


if __name__ == "__main__":
    if "--measure" in sys.argv:
        measure()
    write()
