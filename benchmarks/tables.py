"""The tables of `docs/` and the README, written from measurements in `results/` so that nobody copies numbers by hand.

    python benchmarks/tables.py [--measure]

With --measure the measurements are made anew first: `dropper stability`, `dropper accuracy dropper-north-sea --quick`
and `benchmarks/north_sea.py --effects`, about ten minutes. A table stands in a document between the lines
`<!-- table: NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import channel_tables
import moordyn_tables
import numpy as np
import pitching_tables
import table7_tables
import thesis_tables
import wake_tables

HERE = Path(__file__).parent
RESULTS, DOCS = HERE / "results", HERE.parent / "docs"
COMMANDS = {
    "stability": ["stability", "--json", "--quiet"],
    "accuracy_north_sea": ["accuracy", "dropper-north-sea", "--quick", "--json", "--quiet"],
}
BASELINES = ("thesis_angles 0.51", "thesis_angles 0.5", "theta 0.51", "theta 0.5")
PEERS = ("moordyn rk2", "moordyn default")


def measure() -> None:
    """Make the measurements anew."""
    for name, arguments in COMMANDS.items():
        call = "import sys; from dropper_jax.cli import main; sys.exit(main(sys.argv[1:]))"
        done = subprocess.run([sys.executable, "-c", call, *arguments], stdout=subprocess.PIPE, text=True, check=False)
        (RESULTS / f"{name}.json").write_text(done.stdout)  # a case beyond its limit is a row like the others
    subprocess.run([sys.executable, HERE / "north_sea.py", "--effects"], check=True)


def markdown(rows: list[tuple[str, ...]]) -> str:
    """Rows, the first one the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]])


def stability(found: dict[str, Any]) -> str:
    rows = [("case", "claim", "measured", "limit", "holds", *BASELINES)]
    for row in found["cases"]:
        compared = row["baseline_thesis"] or {}
        measured = "-" if row["measured"] is None else f"{row['measured']:.1e} {row['unit']}"
        baselines = (_baseline(compared.get(label)) for label in BASELINES)
        holds = "yes" if row["ok"] else "**no**"
        rows.append((row["name"], row["claim"], measured, f"{row['limit']:.0e}", holds, *baselines))
    return markdown(rows)


def long_steps(found: dict[str, Any]) -> str:
    """Warnings of steps that are too long, by kind of check and group of scenes."""
    groups = {"tuned": "tuned on", "judged": "judged by"}
    modes = {"whole": "the whole run", "stretches": "stretches"}
    rows = [
        (
            "repeated",
            "scenes",
            "wrong at 3 to 30 times the step",
            "not warned of",
            "right at the step or half of it",
            "warned of",
        )
    ]
    for mode, words in modes.items():
        for group, kind in groups.items():
            row, scenes = found[group][mode], f"{len(found[group]['scenes'])} that it was {kind}"
            missed, false = len(row["without_warning"]), len(row["false_alarms"])
            rows.append((words, scenes, *(str(n) for n in (row["wrong"], missed, row["right"], false))))
    return markdown(rows)


def stability_peers(found: dict[str, Any]) -> str:
    """The cases that MoorDyn was given as well."""
    rows = [("case", "here", "limit", *PEERS)]
    for row in found["cases"]:
        compared = row.get("peers")
        if compared:
            ours = f"{row['measured']:.0e} {row['unit']}"
            rows.append((row["name"], ours, f"{row['limit']:.0e}", *(_peer(compared[label]) for label in PEERS)))
    return markdown(rows)


def _peer(found: dict[str, Any]) -> str:
    if found["status"] != "ok":
        return f"{found['status']} at {found['failed_at_s']:.3g} s"
    return f"{'holds' if found['holds'] else 'wrong'}, {found['measured']:.0e}"


def thesis(found: dict[str, Any]) -> str:
    """The cases that the thesis' schemes were run on as well."""
    rows = [("case", "energy_momentum", *BASELINES)]
    for row in found["cases"]:
        compared = row["baseline_thesis"] or {}
        if any(each["status"] not in ("refused", "not_run") for each in compared.values()):
            ours = row["status"] + ("" if row["unit"] == "-" else f", {row['measured']:.0e} {row['unit']}")
            rows.append((row["name"], ours, *(_baseline(compared.get(label)) for label in BASELINES)))
    return markdown(rows)


def _baseline(found: dict[str, Any] | None) -> str:
    if found is None:
        return "-"
    if found["status"] == "ok":
        share = found["energy_drift_share"]
        return ("wrong" if found["wrong_energy"] else "ok") + ("" if share is None else f", energy {share:.0e}")
    return f"{found['status']} at {found['failed_at_s']:.3g} s" if "failed_at_s" in found else found["status"]


def accuracy_north_sea(found: dict[str, Any]) -> str:
    head = ("scheme", "dt [s]", "RMS angle [rad]", "RMS position [m]", "tension [N]", "status")
    keys = ("rms_angle_error_rad", "rms_position_error_m", "rms_tension_error_n")
    rows = [head]
    for row in found["rows"]:
        errors = ("-" if row[key] is None else f"{row[key]:.1e}" for key in keys)
        rows.append((row["label"], f"{row['dt']:.4g}", *errors, row["status"]))
    reference, orders = found["reference"], found["orders"]
    text = ", ".join(f"{label} {order:.2f}" for label, order in orders.items())
    return (
        f"{markdown(rows)}\n\nCompared over {reference['horizon_s']:.3g} s; reference: {reference['made_by']}, its own "
        f"error {reference['error_estimate_rad']:.1e} rad against {reference['checked_by']}. Measured orders: {text}."
    )


def peers(found: dict[str, Any]) -> str:
    """How many times faster than others at equal or smaller error, where that is least and where it is most."""
    rows = [("line", "against", "goal", "minimum", "maximum", "reached everywhere")]
    for scene in found["scenes"]:
        for goal in scene["goals"]:
            least, most = (
                f"{goal[end]['ratio']:.2g} at {goal[end]['error_m']:.0e} m ({goal[end]['ours'].split(',')[0]} against "
                f"{goal[end]['peer'].split(',')[0]})"
                for end in ("least", "largest")
            )
            held = "yes" if goal["met"] else "**no**"
            rows.append((scene["scene"], goal["goal"], f"{goal['wanted']:g}", least, most, held))
    return markdown(rows)


def sweep(found: dict[str, Any]) -> str:
    """Throughput of a sweep of the lab dropper, saving included."""
    head = ("cases", "steps of each", "until compiled [s]", "run and saved [s]", "million steps per second")
    rows = [(*head, "memory at most [MB]")]
    for row in found["rows"]:
        counts = (f"{row['cases']}", f"{row['steps_per_case']}")
        times = (f"{row['compile_s']:.1f}", f"{row['run_s']:.2f}", f"{row['million_steps_per_s']:.1f}")
        rows.append((*counts, *times, f"{row['peak_memory_mb']:.0f}"))
    single, ratio = found["single_runs_million_steps_per_s"], found["times_faster_than_single_runs"]
    return (
        f"{markdown(rows)}\n\nOn {found['machine']['cores']} cores. A loop over single runs makes {single:.2g} million "
        f"steps per second: the sweep is {ratio:.0f} times as fast."
    )


def sweep_truths(found: dict[str, Any]) -> str:
    """Where the true pair of Table E.1 is among the fifteen, by part and measure, and the fit of the same trace."""
    rows = [
        ("truth: b_l [kg/s], b_q [kg/m]", "head", "middle", "tail", "best other pair, head", "fitted b_l", "fitted b_q")
    ]
    for row in found["rows"]:
        parts = (f"{1e3 * row[part]['angle']['true']:.2f}{_ranks(row[part])}" for part in ("head", "middle", "tail"))
        fit = row.get("fit", {"values": [], "std_errors": []})
        values = [f"{value:.4g} +- {error:.1g}" for value, error in zip(fit["values"], fit["std_errors"], strict=True)]
        values = values or ["not fitted", ""]
        other = f"{1e3 * row['head']['angle']['other']:.2f}"
        rows.append((f"{row['b_l']:g}, {row['b_q']:g}", *parts, other, *values))
    count = len(found["rows"])
    first = {
        (part, by): sum(row[part][by]["rank"] == 1 for row in found["rows"])
        for part in ("head", "middle", "tail")
        for by in ("angle", "spectrum")
    }
    words = [
        f"{first[part, 'angle']} by the {part}'s angles ({first[part, 'spectrum']} by its spectrum)"
        for part in ("head", "middle", "tail")
    ]
    return f"{markdown(rows)}\n\nOf {count} truths the true pair is the best of the list in {', '.join(words)}."


def _ranks(part: dict[str, Any]) -> str:
    """The rank in brackets where it is not the first."""
    rank = part["angle"]["rank"]
    return "" if rank == 1 else f" (rank {rank})"


def report_damping(found: dict[str, Any]) -> str:
    """Loads and damage of a snapping chain by internal damping and step."""
    head = ("damping ratio", "step [s]", "mean anchor load [N]", "largest tension [kN]", "snaps, worst link")
    rows = [(*head, "equivalent range [kN]", "damage per year", "steps retried")]
    for row in found["damping"]:
        loads = (f"{row['mean_anchor_n']:.0f}", f"{row['largest_n'] / 1e3:.1f}", f"{row['snaps']}")
        wear = (f"{row['equivalent_range_n'] / 1e3:.1f}", f"{row['damage_per_year']:.1f}", f"{row['retried']}")
        rows.append((f"{row['damping_ratio']:g}", f"{row['dt_s']:g}", *loads, *wear))
    mean, largest, damage = (
        [row[key] for row in found["damping"]] for key in ("mean_anchor_n", "largest_n", "damage_per_year")
    )
    return (
        f"{markdown(rows)}\n\nThe mean load agrees within {max(mean) / min(mean) - 1:.1%}".replace("%", " %")
        + f". The largest tension differs by a factor of {max(largest) / min(largest):.1f} and the damage by "
        f"{max(damage) / min(damage):.1f}, mostly with the step."
    )


def report_storm(found: dict[str, Any]) -> str:
    """Extremes of a storm from several seeds."""
    kinds = {"most_probable": "most probable", "mean": "mean", "percentile_90": "90th percentile"}
    rows = [("extrapolated to 3 h", "largest of each run [kN]", *(f"{k}, 90 % interval [kN]" for k in kinds.values()))]
    for row in found["storm"]["rows"]:
        low, high = (x / 1e3 for x in row["maxima"])
        cells = (", ".join((f"{row[key][0] / 1e3:.1f}", _from_to(row[key][1:]))) for key in kinds)
        rows.append((row["what"], f"{low:.1f} to {high:.1f}", *cells))
    storm = found["storm"]
    return (
        f"{markdown(rows)}\n\nThe largest tension of {storm['further_seeds']} further seeds, which make up 3 h, is "
        f"{storm['further_largest_n'] / 1e3:.1f} kN. Steps retried in a run: at most {storm['retried']}."
    )


def _from_to(interval: list[float]) -> str:
    return f"{interval[0] / 1e3:.1f} to {interval[1] / 1e3:.1f}"


def scene_sensitivity(found: dict[str, Any]) -> str:
    """Exact derivatives of a tension to numbers of its scene, beside differences."""
    rows = [("number of the scene", "value", "derivative [N per unit]", "by differences", "per cent for one per cent")]
    for row in found["rows"]:
        numbers = (f"{row['derivative']:.6g}", f"{row['differences']:.6g}", f"{row['scaled']:.2g}")
        rows.append((f"`{row['path']}`", f"{row['value']:.5g} {row['unit']}".removesuffix(" -"), *numbers))
    return (
        f"{markdown(rows)}\n\n`{found['of']}` of `{found['scene']}` is {found['value']:.1f} N; forward and reverse "
        f"mode differ by {found['modes_differ']:.0e}."
    )


def convergence(found: dict[str, Any]) -> str:
    names = ("mean", "deviation", "quantile", "window maximum")
    rows = [("scene", "step [s]", "mean", "deviation", "99.9 % in time", "mean of windows' maxima", "largest")]
    for scene, steps in found["scenes"].items():
        for row in steps:
            cells = []
            for name in names:
                agree = "" if row[f"{name} agrees"] == row["lines"] else f" ({row[f'{name} agrees']} of {row['lines']})"
                cells.append(f"{100 * row[name]:.2g} %{agree}")
            rows.append((scene, f"{row['dt']:.3g}", *cells, f"{100 * row['largest']:.2g} %"))
    return markdown(rows)


def one_kernel(found: dict[str, Any]) -> str:
    rows = [("run", "launched one by one [us per step]", "one kernel", "times faster", "compilation [s]", "one kernel")]
    for row in found["rows"]:
        times = (f"{row['plain_us']:.3g}", f"{row['one_kernel_us']:.3g}", f"{row['times_faster']:.1f}")
        rows.append((row["case"], *times, f"{row['plain_compile_s']:.1f}", f"{row['one_kernel_compile_s']:.1f}"))
    return markdown(rows)


def films(found: dict[str, Any]) -> str:
    """Films of known motion, tracked with boards and without."""
    head = ("film", "boards", "order", "RMS error [mrad]", "maximum [mrad]", "stated over true error", "of each link")
    rows = [(*head, "left empty", "marked")]
    for row in found["films"]:
        first = (row["film"], "yes" if row["calibrated"] else "no")
        if "rms_mrad" not in row:
            rows.append((*first, "not known, exit 3", *["-"] * 6))
            continue
        low, high = row["of_links"]
        errors = (f"{row['rms_mrad']:.2f}", f"{row['largest_mrad']:.1f}", f"{row['stated_over_true']:.2f}")
        shares = (f"{100 * row['empty_share']:.1f} %", f"{100 * row['marked_share']:.1f} %")
        order = "right" if row["right_order"] else "**wrong**"
        rows.append((*first, order, *errors, f"{low:.2f} to {high:.2f}", *shares))
    total = {key: sum(row[key] for row in found["marks"]) for key in found["marks"][0] if key != "film"}
    share = lambda part, whole: f"{100 * total[part] / total[whole]:.1f} %"  # noqa: E731
    return (
        f"{markdown(rows)}\n\nOf {total['swapped']} frames in which two nodes were made to swap names "
        f"{share('swapped_found', 'swapped')} are marked, of {total['jumped']} in which one was shifted by 0.2 to 1 "
        f"link {share('jumped_found', 'jumped')}, of {total['well']} others {share('well_marked', 'well')}."
    )


def random_droppers(found: dict[str, Any]) -> str:
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
        cover, rms = (", ".join(form.format(x) for x in two) for form, two in (("{:.0%}", inside), ("{:.2f}", spread)))
        row = (f"{len(rows)}, {kind}", str(len(ok)), str(len(good)), str(len(wrong)), str(len(printed)), cover, rms)
        lines.append(row)
    return markdown(lines)


def descent(found: dict[str, Any]) -> str:
    """Gradient descent beside Gauss-Newton."""
    rows = [("method", "evaluations", "processor [s]", "b_l [kg/s]", "b_q [kg/m]", "off by [standard errors]")]
    for row in found["rows"]:
        numbers = (f"{v:.6f} +- {e:.6f}" for v, e in zip(row["values"], row["std_errors"], strict=True))
        off = zip(row["values"], found["truth"], row["std_errors"], strict=True)
        departure = ", ".join(f"{(v - t) / e:+.2f}" for v, t, e in off)
        rows.append((row["method"], f"{row['evaluations']}", f"{row['processor_s']:.1f}", *numbers, departure))
    truth = "truth", "", "", *(f"{value:g}" for value in found["truth"]), ""
    return markdown([*rows, truth])


SOURCE_HEADS = {
    "thesis": ("table", "there", "here", "why"),
    "paper": ("table", "there", "here", "why"),
    "figures": ("figure", "shows", "scenes", ""),
}
#: Results (`results/NAME.json`) and what writes them, by name of the table.
TABLES = {
    **{
        name: ("moordyn", lambda found, rows=rows: markdown(rows(found)))
        for name, rows in moordyn_tables.TABLES.items()
    },
    **{
        name: ("pitching", lambda found, rows=rows: markdown(rows(found)))
        for name, rows in pitching_tables.TABLES.items()
    },
    **{
        name: ("farm_wakes", lambda found, rows=rows: markdown(rows(found)))
        for name, rows in wake_tables.TABLES.items()
    },
    "table7_peaks": ("table7_peaks", lambda found: markdown(table7_tables.peaks(found))),
    **{
        f"sources_{part}": ("sources", lambda found, part=part: markdown([SOURCE_HEADS[part], *found[part]]))
        for part in SOURCE_HEADS
    },
    "edulis_anchors": ("edulis_anchors", lambda found: markdown(table7_tables.anchors(found))),
    **{name: ("table7", lambda found, rows=rows: markdown(rows(found))) for name, rows in table7_tables.TABLES.items()},
    "moordyn_rest": ("moordyn_rest", lambda found: markdown(moordyn_tables.rest(found))),
    "sweep": ("sweep", sweep),
    "sweep_truths": ("sweep_truths", sweep_truths),
    "scene_sensitivity": ("scene_sensitivity", scene_sensitivity),
    "report_damping": ("report_examples", report_damping),
    "report_storm": ("report_examples", report_storm),
    "long_steps": ("long_steps", long_steps),
    "stability": ("stability", stability),
    "stability_peers": ("stability", stability_peers),
    "thesis": ("stability", thesis),
    "accuracy_north_sea": ("accuracy_north_sea", accuracy_north_sea),
    "north_sea": ("north_sea", lambda found: markdown(thesis_tables.north_sea(found))),
    "thesis_release": ("thesis_release", lambda found: markdown(thesis_tables.thesis_release(found))),
    "thesis_dampings": (
        "thesis_release",
        lambda found: markdown(thesis_tables.thesis_dampings(found)) + thesis_tables.independent(found),
    ),
    "peers": ("peers", peers),
    "one_kernel": ("one_kernel", one_kernel),
    "convergence": ("convergence", convergence),
    "films": ("films", films),
    "descent": ("descent", descent),
    "random_droppers": ("random_droppers", random_droppers),
    "channels": ("channels", lambda found: markdown(channel_tables.channels(found))),
}


def filled(text: str) -> str:
    """A document with the tables that it asks for."""
    for name in re.findall(r"<!-- table: (\w+) -->", text):
        results, table_of = TABLES[name]
        table = table_of(json.loads((RESULTS / f"{results}.json").read_text()))
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
