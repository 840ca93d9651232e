"""Tables of fits."""

import itertools
import re
from collections import Counter

import numpy as np
from scipy.special import betaincinv
from study import Found, Rows, columns, joined, table_of


@table_of("random_droppers")
def random_droppers(found: Found) -> Rows:
    """Fits of random droppers: how many are right, and how good their errors are."""

    def counted(kind: str, rows: list[Found]) -> Found:
        ok = [row for row in rows if row["status"] == "ok"]
        values, truth, low, high, error = (
            np.array([row[key] for row in ok]) for key in ("values", "truth", "low", "high", "std_error")
        )
        noise = np.array([row["residual"] / row["noise"] for row in ok])
        fitted = np.array([row["fitted"] for row in ok])
        sharp = ~np.array([row["at_bound"] for row in ok]) & (error < 0.5 * values)
        return {
            "draws": f"{len(rows)}, {kind}",
            "ok": len(ok),
            "good": np.sum((noise >= 0.95) & (noise <= 1.05) & (fitted >= 0.97)),
            "wrong": np.sum(noise > 1.4),
            "printed": sum(abs(row["printed_noise"] / row["noise"] - 1) < 0.1 for row in rows),
            "inside": np.mean((low <= truth) & (truth <= high), axis=0),
            "spread": np.sqrt(np.mean(((values - truth) / error) ** 2, axis=0, where=sharp)),
        }

    return columns(
        itertools.starmap(counted, found.items()),
        ("draws", "{draws}"),
        ("`ok`", "{ok}"),
        ("and explain their trace", "{good}"),
        ("wrong", "{wrong}"),
        ("noise within 10 %", "{printed}"),
        ("90 % intervals of b_l, b_q hold", "{inside[0]:.0%}, {inside[1]:.0%}"),
        ("error over standard error, RMS", "{spread[0]:.2f}, {spread[1]:.2f}"),
    )


@table_of("sensor_plan")
def sensor_plan(found: Found) -> Rows:
    """Durations of tests with the same errors of b_l and b_q, by their sensors."""
    rows = []
    for row in found["rows"]:
        times = [f"{x:.3g}" for x in row["same_error_after_s"]]
        rows.append({"sensors": row["sensors"], "times": times, "errors": row["errors"][found["times_s"].index(4.0)]})
    lasting = [f"{x:g} s" for x in found["compared_s"]]
    return columns(
        rows,
        ("sensors", "{sensors}"),
        *((f"as {text} of angles [s]", f"{{times[{i}]}}") for i, text in enumerate(lasting)),
        ("errors of b_l [kg/s], b_q [kg/m] after 4 s", "{errors[0]:.2g}, {errors[1]:.2g}"),
    )


@table_of("flume_test")
def flume_test(found: Found) -> Rows:
    """Drag and added mass of a dropper from a test in waves: their means, scatter, errors and intervals."""
    rows = found["rows"]
    values, errors, inside = (np.array([row[key] for row in rows]) for key in ("values", "std_errors", "inside"))
    planned = found["planned"][-1]["errors"]
    cells = []
    for i, (name, truth) in enumerate(found["truth"].items()):
        cells.append(
            {
                "name": name,
                "truth": truth,
                "exact": found["exact"]["values"][i],
                "mean": np.mean(values[:, i]),
                "scatter": np.std(values[:, i], ddof=1),
                "error": np.median(errors[:, i]),
                "planned": planned[i],
                "inside": f"{np.sum(inside[:, i])} of {len(rows)}",
            }
        )
    return columns(
        cells,
        ("value", "`{name}`"),
        ("true, in MoorDyn", "{truth}"),
        ("fitted, no noise", "{exact:.4f}"),
        ("mean", "{mean:.4f}"),
        ("scatter", "{scatter:.4f}"),
        ("standard error, median", "{error:.4f}"),
        ("planned error", "{planned:.4f}"),
        ("intervals of 90 % that hold the truth", "{inside}"),
    )


def share_within(count: int, draws: int, level: float = 0.95) -> tuple[float, float]:
    """Interval of a probability of which this many of the draws were seen (Clopper and Pearson 1934)."""
    tail = 0.5 * (1 - level)
    low = float(betaincinv(count, draws - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, draws - count, 1 - tail)) if count < draws else 1.0
    return low, high


#: Parts of `right_laws`, and what the table calls them.
RIGHT = {"droppers": "random droppers", "chains": "four links between fixed ends"}


@table_of("right_laws", "wrong_laws")
def right_laws(found: Found, others: Found) -> Rows:
    """Fits of right models, with the tests of the law: how often one is rejected, and how good their errors are."""

    def counted(name: str, rows: list[Found]) -> Found:
        status = Counter(row["status"] for row in rows)
        flagged = status.pop("model_error", 0)
        rest = ", ".join(f"{count} `{one}`" for one, count in status.items() if one != "ok")
        least, most = share_within(flagged, len(rows))
        z = np.concatenate([errors_of(row) for row in rows])
        return {
            "kind": name,
            "draws": len(rows),
            "flagged": f"{flagged} ({least:.1%} to {most:.1%})",
            "rest": rest or "-",
            "inside": float(np.mean(np.abs(z) < NORMAL_90)),
            "spread": float(np.sqrt(np.mean(z**2))),
        }

    parts = {name: found[part] for part, name in RIGHT.items() if part in found}
    parts["2 to 5 links, of the table below"] = [row["right"] for row in others["draws"] if "right" in row]
    parts["all"] = [row for part in list(parts.values()) for row in part]
    return columns(
        itertools.starmap(counted, parts.items()),
        ("right models", "{kind}"),
        ("draws", "{draws}"),
        ("`model_error` (95 % interval)", "{flagged}"),
        ("other statuses", "{rest}"),
        ("values within 1.64 standard errors", "{inside:.0%}"),
        ("error over standard error, RMS", "{spread:.2f}"),
    )


#: Standard errors within which 90 % of normal errors are.
NORMAL_90 = 1.6449


def errors_of(row: Found) -> np.ndarray:
    """Errors of a row's values in standard errors, without values at a bound."""
    if "errors" in row:
        return np.array(row["errors"])
    value, truth, error, at_bound = (np.array(row[key]) for key in ("values", "truth", "std_error", "at_bound"))
    return ((value - truth) / error)[~at_bound]


@table_of("fit_bias")
def fit_bias(found: Found) -> Rows:
    """Errors of fits without noise, and the mean error by noise, in stated errors."""
    rows = found["rigs"]
    z = {key: np.abs([row[key] for row in rows]) for key in ("without_noise", "half_the_step", "errors")}
    by_noise = np.abs([np.mean(row["by_noise"], axis=0) for row in rows])
    listed = [
        ("fit of noisy samples", z["errors"]),
        ("without noise", z["without_noise"]),
        ("without noise, half the step", z["half_the_step"]),
        ("mean of a noise and its negative, without the error of the step", by_noise),
    ]
    return columns(
        ({"name": name, "size": size} for name, size in listed),
        ("fit", "{name}"),
        ("median [standard errors]", lambda r: f"{np.median(r['size']):.2g}"),
        ("maximum", lambda r: f"{np.max(r['size']):.2g}"),
        ("rigs above 0.2", lambda r: f"{int(np.sum(np.max(r['size'], axis=1) > 0.2))} of {len(rows)}"),
    )


#: Standard errors of a force with all others free, from which a trace should show it.
SHOWABLE = 5.0
#: Faults that leave one coefficient without a true value.
OTHER_LAW = ("only_linear", "only_quadratic")


@table_of("wrong_laws")
def wrong_laws(found: Found) -> Rows:
    """Fits whose law lacks a force, by fault, and those of the same rigs without a fault."""
    draws = [row for row in found["draws"] if "wrong" in row]
    small = [row for row in draws if (row["times"] or SHOWABLE) < SHOWABLE]
    draws = [row for row in draws if row not in small]

    def is_far_off(row: Found) -> bool:
        off = zip(row.get("errors", []), row.get("relative", []), strict=True)
        return any(abs(error) > 4 and abs(share or 0) > 0.05 for error, share in off)

    def counted(name: str, rows: list[Found], law: str) -> Found:
        shown = [row for row in rows if row.get("least_p", 1.0) < 0.01]
        right = [row for row in shown if law and any(x.startswith(law) for x in (row["first"], *row["alike"]))]
        status = Counter(row["status"] for row in rows)
        others = ", ".join(f"{count} `{one}`" for one, count in status.items() if one not in ("ok", "model_error"))
        wrong = [row for row in rows if row["status"] == "ok" and name not in OTHER_LAW and is_far_off(row)]
        return {
            "fault": name.replace("_", " "),
            "draws": len(rows),
            "shown": len(shown),
            "right": len(right) if law else "-",
            "error": status["model_error"],
            "ok": status["ok"],
            "others": others or "-",
            "wrong": len(wrong),
        }

    faults = {draw["fault"]: draw["law"] for draw in draws}
    right = [draw["right"] for draw in found["draws"] if "right" in draw]
    rows = [counted("none", right, "")]
    for fault, law in sorted(faults.items()):
        rows.append(counted(fault, [draw["wrong"] for draw in draws if draw["fault"] == fault], law))
    if small:
        rows.append(counted("below 5 standard errors", [draw["wrong"] for draw in small], ""))
    return columns(
        rows,
        ("fault", "{fault}"),
        ("draws", "{draws}"),
        ("a force is shown (p below 1 %)", "{shown}"),
        ("and the right one first", "{right}"),
        ("`model_error`", "{error}"),
        ("`ok`", "{ok}"),
        ("other statuses", "{others}"),
        ("`ok` and off by more than 4 errors and 5 %", "{wrong}"),
    )


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


def _kind_of(name: str) -> str:
    """A first name without its numbers."""
    if "lost frames" in name:
        return "lost frames"
    return re.sub(r" (\d|\(.*\))", "", name) or "nothing"


def _rightly_named(row: Found) -> bool:
    """Whether the first name is the spoiler, its link or node as well."""
    if row["spoiler"] == "lengths and roll":
        return all(any(part in name for name in row["names"]) for part in ("lengths", "roll"))
    if row["truth"] in ("outliers", "lost frames"):
        return _kind_of(row["first"]) == row["truth"]
    return row["first"].split(" or ")[0] == row["truth"]
