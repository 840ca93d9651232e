"""Tables of docs/moordyn-compared.md from `results/table7.json`, which `benchmarks/table7.py` writes."""

from __future__ import annotations

from typing import Any

Rows = list[tuple[str, ...]]

CODES = (("orcaflex", "OrcaFlex"), ("adapted_moordyn", "adapted MoorDyn"))
NUMBERS = (1, 2, 3, 4, 5)
#: Deviation [m] below which a motion is left out.
UNMOVED = 0.01


def cases(found: dict[str, Any]) -> Rows:
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
        for key, code in CODES:
            low, mean, high = found["table_7"][name][key]
            rows.append((name, f"Table 7: {code}", f"{low:.0f}", f"{mean:.0f}", f"{high:.0f}", "-", "-", "-"))
    return rows


def lengths(found: dict[str, Any]) -> Rows:
    """Mean anchor tension by length of the record."""
    spans = [span["span_s"] for span in found["cases"][0]["spans"]]
    head = [f"first {span:g} s" for span in spans]
    rows = [("case", *head, "from 50 to 150 s", *(f"Table 7: {code}" for _, code in CODES))]
    for row in found["cases"]:
        means = [span["anchor"]["mean"] for span in row["spans"]]
        first = means[spans.index(50.0)]
        settled = (means[spans.index(150.0)] * 150.0 - first * 50.0) / 100.0
        error = _span(found, row["case"])["standard_error"]
        paper = (f"{found['table_7'][str(row['case'])][key][1]:.0f}" for key, _ in CODES)
        rows.append((str(row["case"]), *(f"{mean:.0f}" for mean in means), f"{settled:.0f} ± {error:.0f}", *paper))
    return rows


def peaks(found: dict[str, Any]) -> Rows:
    """Largest anchor tension by scheme and step, the range over moved starts, and the paper's two codes."""
    schemes = list(dict.fromkeys(row["scheme"] for row in found["rows"]))
    head = ("case", *(f"{scheme} [kN] (step [ms])" for scheme in schemes), "starts moved by up to 1e-6 m [kN]")
    rows = [(*head, *(f"Table 7: {code} [kN]" for _, code in CODES))]
    for number in NUMBERS:
        own = [r for r in found["rows"] if r["case"] == number and r["status"] == "ok"]
        still = [r for r in own if r["moved_m"] == 0.0]
        moved = [r["anchor"]["max"] for r in own if r["moved_m"] != 0.0]
        of = {
            scheme: [f"{_kilo(r['anchor']['max'])} ({1e3 * r['dt_s']:.3g})" for r in still if r["scheme"] == scheme]
            for scheme in schemes
        }
        paper = (_kilo(found["table_7"][str(number)][key][2]) for key, _ in CODES)
        cells = (", ".join(of[scheme]) or "-" for scheme in schemes)
        rows.append(
            (
                str(number),
                *cells,
                f"{_kilo(min(moved))} to {_kilo(max(moved))} ({len(moved)})" if moved else "-",
                *paper,
            )
        )
    return rows


def _kilo(newton: float) -> str:
    return f"{1e-3 * newton:.1f}" if newton >= 1e4 else f"{1e-3 * newton:.2f}"


def anchors(found: dict[str, Any]) -> Rows:
    """Edulis' anchors by heading of the tide."""
    names = list(found["rows"][0]["largest_load_n"])
    rows = [("heading [deg]", *(f"{name} [kN] ([%])" for name in names), "moved [m]")]
    for row in found["rows"]:
        cells = (f"{1e-3 * row['largest_load_n'][n]:.2f} ({100 * row['utilisation'][n]:.1f})" for n in names)
        rows.append((str(row["heading_deg"]), *cells, f"{row['moved_m']:.1f}"))
    return rows


def conventions(found: dict[str, Any]) -> Rows:
    """By how much one change moves the mean anchor tension of each case."""
    base = {number: _span(found, number) for number in NUMBERS}
    rows = [("one change", *(f"case {number}, mean [N]" for number in NUMBERS), "case 4, largest [N]")]
    largest = f"{base[4]['anchor']['max']:.0f}"
    rows.append(("none: from Table 6, 150 s", *(f"{base[n]['anchor']['mean']:.0f}" for n in NUMBERS), largest))
    for name in dict.fromkeys(row["convention"] for row in found["conventions"]):
        own = {row["case"]: row for row in found["conventions"] if row["convention"] == name}
        cells = [_moved(own[n], base[n]) if n in own else "-" for n in NUMBERS]
        spans = own[4]["spans"] if 4 in own else []
        rows.append((name, *cells, f"{spans[0]['anchor']['max']:.0f}" if spans else "-"))
    node = [_signed(base[n]["anchor_node"]["mean"] - base[n]["anchor"]["mean"]) for n in NUMBERS]
    rows.append(("force on the anchor's node, not tension of its link", *node, f"{base[4]['anchor_node']['max']:.0f}"))
    for ratio in dict.fromkeys(row["damping_ratio"] for row in found["moordyn"]):
        own = {row["case"]: row for row in found["moordyn"] if row["damping_ratio"] == ratio}
        for size, word in ((False, ""), (True, ", pushing counted as pulling")):
            cells = [_other(own[n], base[n], size) for n in NUMBERS]
            top = f"{own[4]['anchor']['max']:.0f}" if own[4]["status"] == "ok" else "-"
            rows.append((f"MoorDyn v2, damping ratio {ratio:g}{word}", *cells, top))
    for key, code in CODES:
        paper = {n: found["table_7"][str(n)][key] for n in NUMBERS}
        cells = [_signed(paper[n][1] - base[n]["anchor"]["mean"]) for n in NUMBERS]
        rows.append((f"Table 7: {code}", *cells, f"{paper[4][2]:.0f}"))
    rows += [_record(found, span, base) for span in (50.0, 200.0)]
    errors = [f"± {base[n]['standard_error']:.0f}" for n in NUMBERS]
    rows.append(("chance (batch means, 50 to 150 s)", *errors, "-"))
    return rows


def edulis(found: dict[str, Any]) -> Rows:
    """Edulis in both codes."""
    rows = [
        ("", "mean, here", "mean, MoorDyn v2", "deviation, here", "deviation, MoorDyn v2", "largest, here / MoorDyn v2")
    ]
    for row in found["edulis"]["rows"]:
        if row["deviation"]["here"] < UNMOVED:
            continue
        force = row["mean"]["here"] > 100.0
        cells = []
        for what in ("mean", "deviation"):
            one = row[what]
            error = one["step"] + one["links"]
            cells.append(f"{_number(one['here'], force)} ± {_number(error, force)} ({_number(one['chance'], force)})")
            cells.append(f"{_number(one['moordyn'], force)} ± {_number(one['moordyn_step'], force)}")
        top = row["max"]
        cells.append(f"{_number(top['here'], force)} / {_number(top['moordyn'], force)}")
        rows.append((f"{row['name']} {'[N]' if force else '[m]'}", *cells))
    return rows


def _record(found: dict[str, Any], span: float, base: dict[int, dict[str, Any]]) -> tuple[str, ...]:
    """A record of another length."""
    own = {row["case"]: next(s for s in row["spans"] if s["span_s"] == span) for row in found["cases"]}
    cells = [_signed(own[n]["anchor"]["mean"] - base[n]["anchor"]["mean"]) for n in NUMBERS]
    return (f"{span:g} s instead of 150 s", *cells, f"{own[4]['anchor']['max']:.0f}")


def _span(found: dict[str, Any], number: int) -> dict[str, Any]:
    """The case itself, over the length that is compared."""
    row = next(row for row in found["cases"] if row["case"] == number)
    return next(span for span in row["spans"] if span["span_s"] == found["span_s"])


def _three(values: dict[str, float] | None) -> tuple[str, ...]:
    if values is None:
        return ("-", "-", "-")
    return tuple(f"{values[key] + 0.0:.0f}".replace("-0", "0") for key in ("min", "mean", "max"))


def _moved(row: dict[str, Any], base: dict[str, Any]) -> str:
    if not row["spans"]:
        return row["status"].split(" ")[0]
    return _signed(row["spans"][0]["anchor"]["mean"] - base["anchor"]["mean"])


def _other(row: dict[str, Any], base: dict[str, Any], size: bool) -> str:
    if row["status"] != "ok":
        return row["status"]
    anchor = row["anchor"]["size"] if size else row["anchor"]
    return _signed(anchor["mean"] - base["anchor"]["mean"])


def _signed(newton: float) -> str:
    return f"{newton:+.0f}"


def _number(value: float | None, force: bool) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if force else f"{value:.2f}"


TABLES = {
    "table7_cases": cases,
    "table7_lengths": lengths,
    "table7_conventions": conventions,
    "table7_edulis": edulis,
}
