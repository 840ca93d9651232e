"""Tables of MoorDyn's runs compared with those of this package."""

from study import Found, Rows, columns, joined, kilo, milli, table_of

#: The step of ours that the speed table shows where none is as exact as MoorDyn [s].
USUAL = 0.02
CODES = (("ours", "here"), ("moordyn", "MoorDyn v2"))


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
        ("least [kN]", lambda r: kilo(r["min"])),
        ("largest [kN]", lambda r: kilo(r["max"])),
    )


@table_of("moordyn")
def moordyn_conventions(found: Found) -> Rows:
    """Static anchor tension of case 4 by conventions."""
    return columns(found["case_4"], ("case 4", "{convention}"), ("anchor tension [N]", "{anchor_n:.1f}"))


@table_of("moordyn")
def moordyn_speed(found: Found) -> Rows:
    """Processor time per simulated second, errors, and how much faster at equal or smaller error."""

    def ours(row: Found) -> Found:
        if row["all_steps"] is None:
            shown = USUAL
        else:
            shown = row["all_steps"]["ours_dt_s"]
        return {"shown": shown, **next(run for run in row["our_runs"] if abs(run["dt_s"] / shown - 1.0) < 1e-9)}

    return columns(
        ({**row, "ours": ours(row)} for row in found["speed"]),
        ("", "{name}"),
        ("rope law and scheme here", "{law}, {integrator}"),
        ("MoorDyn [ms]", lambda r: milli(r["moordyn"]["cpu_per_s"])),
        ("errors of mean, deviation", lambda r: _pair(r["moordyn"]["errors"])),
        ("here, dt [s]", "{ours[shown]:.3g}"),
        ("[ms]", lambda r: milli(r["ours"]["cpu_per_s"])),
        ("errors of mean, deviation", lambda r: _pair(r["ours"]["errors"])),
        ("goal", "{wanted:g} times"),
        ("as exact", _as_exact),
    )


def _as_exact(row: Found) -> str:
    """How fast at equal or smaller error, bold where that misses what was wanted."""
    whole = row["all_steps"]
    slow = row["below_5_hz"]
    if whole is None:
        text = "at no step tried"
    else:
        text = f"{_compared(whole)} (at {whole['ours_dt_s']:.2g} s)"
    if whole is None or whole["ratio"] < row["wanted"]:
        text = f"**{text}**"
    if slow is None or slow == whole:
        return text
    return f"{text}; {_compared(slow)} for means over 0.1 s (at {slow['ours_dt_s']:.2g} s)"


def _compared(found: Found) -> str:
    words = "times faster" if found["ratio"] >= 1.0 else "times as fast"
    return f"{found['ratio']:.2g} {words}"


def _pair(errors: Found | None) -> str:
    if errors is None:
        return "-"
    return f"{errors['mean']:.1e}, {errors['std']:.1e}"


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
        ("[ms]", lambda r: "" if r["best"] is None else milli(r["best"]["cpu_per_s"])),
        (
            "errors of mean, deviation, window maxima",
            lambda r: "none" if r["best"] is None else _errors(r["best"]["errors"]),
        ),
        ("of the reference", lambda r: _errors(r["own"]["reference_errors"])),
        ("mean of window maxima [N]", "{own[reference][peaks]:.0f}"),
        ("MoorDyn's time over ours", lambda r: "" if r["key"] == "ours" or not r["ratio"] else f"{r['ratio']:.1f}"),
    )


def _step(row: Found) -> str:
    if row.get("accuracy") is not None:
        return f"up to {row['dt_s']:g}, accuracy {row['accuracy']:g}"
    # stored measurements of steps that followed the change of tensions
    if row.get("tolerance") is not None:
        return f"up to {row['dt_s']:g}, tolerance {row['tolerance']:g} m/s"
    return f"{row['dt_s']:g}"


def _errors(errors: dict[str, float]) -> str:
    return joined([100 * errors[key] for key in ("mean", "std", "peaks")], "{:.2g} %")
