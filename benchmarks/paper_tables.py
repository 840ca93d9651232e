"""Tables of the paper's cases."""

from study import Found, Rows, columns, joined, table_of

PAPER = (("orcaflex", "OrcaFlex"), ("adapted_moordyn", "adapted MoorDyn"))
NUMBERS = (1, 2, 3, 4, 5)
#: Deviation [m] below which a motion is left out.
UNMOVED = 0.01


@table_of("table7")
def table7_cases(found: Found) -> Rows:
    """Least, mean and largest tension at both ends, the start included."""

    def codes(number: int) -> Found:
        """Tensions of anchor and fairlead by code."""
        here, ratio = _span(found, number), "MoorDyn v2, damping ratio {damping_ratio:g}"
        own = [r for r in filter(_is_whole, found["moordyn"]) if r["case"] == number and r["damping_ratio"] > 0.0]
        return {
            "here": (here["anchor"], here["fairlead"]),
            "here, force on the end node": (here["anchor_node"], None),
            **{ratio.format(**row): [row[end]["size"] for end in ("anchor", "fairlead")] for row in own},
            **{f"Table 7: {code}": (_paper(found, number, key), None) for key, code in PAPER},
        }

    head = ("case", "code", "anchor: least [N]", "mean", "largest", "fairlead: least [N]", "mean", "largest")
    rows = ((str(n), code, *map(_three, ends)) for n in NUMBERS for code, ends in codes(n).items())
    return [head, *((number, code, *anchor, *fairlead) for number, code, anchor, fairlead in rows)]


@table_of("table7")
def table7_lengths(found: Found) -> Rows:
    """Mean anchor tension by length of the record."""

    def mean(row: Found, length: float) -> float:
        return _span(found, row["case"], length)["anchor"]["mean"]

    def settled(row: Found) -> str:
        late = (mean(row, 150.0) * 150.0 - mean(row, 50.0) * 50.0) / 100.0
        return f"{late:.0f} ± {_span(found, row['case'])['standard_error']:.0f}"

    lengths = [span["span_s"] for span in found["cases"][0]["spans"]]
    return columns(
        found["cases"],
        ("case", "{case}"),
        *((f"first {length:g} s", lambda r, at: f"{mean(r, at):.0f}", length) for length in lengths),
        ("from 50 to 150 s", settled),
        *(
            (f"Table 7: {code}", lambda r, by: f"{_paper(found, r['case'], by)['mean']:.0f}", key)
            for key, code in PAPER
        ),
    )


@table_of("table7")
def table7_conventions(found: Found) -> Rows:
    """By how much one change moves the mean anchor tension of each case."""
    base = {number: _span(found, number) for number in NUMBERS}
    loads: dict[str, dict[int, Found]] = {}
    for one in found["conventions"]:
        for span in one["spans"]:
            loads.setdefault(one["convention"], {})[one["case"]] = span["anchor"]
    loads["force on the anchor's node, not tension of its link"] = {n: base[n]["anchor_node"] for n in NUMBERS}
    for one in filter(_is_whole, found["moordyn"]):
        name = f"MoorDyn v2, damping ratio {one['damping_ratio']:g}"
        loads.setdefault(name, {})[one["case"]] = one["anchor"]
        loads.setdefault(f"{name}, pushing counted as pulling", {})[one["case"]] = one["anchor"]["size"]
    loads |= {f"Table 7: {code}": {n: _paper(found, n, key) for n in NUMBERS} for key, code in PAPER}
    loads |= {f"{x:g} s instead of 150 s": {n: _span(found, n, x)["anchor"] for n in NUMBERS} for x in (50.0, 200.0)}

    def change(own: dict[int, Found], number: int) -> str:
        return f"{own[number]['mean'] - base[number]['anchor']['mean']:+.0f}" if number in own else "-"

    def largest(own: dict[int, Found]) -> str:
        return f"{own[4]['max']:.0f}" if 4 in own else "-"

    return [
        ("one change", *(f"case {number}, mean [N]" for number in NUMBERS), "case 4, largest [N]"),
        (
            "none: from Table 6, 150 s",
            *(f"{base[n]['anchor']['mean']:.0f}" for n in NUMBERS),
            largest({4: base[4]["anchor"]}),
        ),
        *((name, *(change(own, n) for n in NUMBERS), largest(own)) for name, own in loads.items()),
        ("chance (batch means, 50 to 150 s)", *(f"± {base[n]['standard_error']:.0f}" for n in NUMBERS), "-"),
    ]


def _is_whole(row: Found) -> bool:
    """Whether a run reached its end."""
    return row["status"] == "ok"


def _span(found: Found, number: int, length: float | None = None) -> Found:
    """A case over a length of the record, that which is compared unless given."""
    row = next(row for row in found["cases"] if row["case"] == number)
    return next(span for span in row["spans"] if span["span_s"] == (length or found["span_s"]))


def _paper(found: Found, number: int, code: str) -> dict[str, float]:
    """Anchor tension [N] of a case in the paper's Table 7."""
    return dict(zip(("min", "mean", "max"), found["table_7"][str(number)][code], strict=True))


def _three(values: dict[str, float] | None) -> tuple[str, ...]:
    if values is None:
        return ("-", "-", "-")
    return tuple(f"{values[key] + 0.0:.0f}".replace("-0", "0") for key in ("min", "mean", "max"))


@table_of("table7")
def table7_edulis(found: Found) -> Rows:
    """Edulis in both codes."""

    def here(row: Found, what: str) -> str:
        one, form = row[what], row["form"]
        return f"{one['here']:{form}} ± {one['step'] + one['links']:{form}} ({one['chance']:{form}})"

    def there(row: Found, what: str) -> str:
        return "{moordyn:{form}} ± {moordyn_step:{form}}".format(form=row["form"], **row[what])

    units = {True: {"unit": "N", "form": ".0f"}, False: {"unit": "m", "form": ".2f"}}
    return columns(
        (
            {**row, **units[row["mean"]["here"] > 100.0]}
            for row in found["edulis"]["rows"]
            if row["deviation"]["here"] >= UNMOVED
        ),
        ("", "{name} [{unit}]"),
        ("mean, here", here, "mean"),
        ("mean, MoorDyn v2", there, "mean"),
        ("deviation, here", here, "deviation"),
        ("deviation, MoorDyn v2", there, "deviation"),
        ("largest, here / MoorDyn v2", "{max[here]:{form}} / {max[moordyn]:{form}}"),
    )


@table_of("table7_peaks")
def table7_peaks(found: Found) -> Rows:
    """Largest anchor tension by scheme and step, the range over moved starts, and the paper's two codes."""
    good = list(filter(_is_whole, found["rows"]))

    def kilo(newton: float) -> str:
        return f"{1e-3 * newton:.1f}" if newton >= 1e4 else f"{1e-3 * newton:.2f}"

    def at(case: Found, scheme: str) -> str:
        own = (r for r in case["runs"] if r["moved_m"] == 0.0 and r["scheme"] == scheme)
        return ", ".join(f"{kilo(r['anchor']['max'])} ({1e3 * r['dt_s']:.3g})" for r in own)

    def moved(case: Found) -> str:
        tops = [r["anchor"]["max"] for r in case["runs"] if r["moved_m"] != 0.0]
        return f"{kilo(min(tops))} to {kilo(max(tops))} ({len(tops)})"

    return columns(
        ({"case": n, "runs": [row for row in good if row["case"] == n]} for n in NUMBERS),
        ("case", "{case}"),
        *((f"{name} [kN] (step [ms])", at, name) for name in dict.fromkeys(row["scheme"] for row in found["rows"])),
        ("starts moved by up to 1e-6 m [kN]", moved),
        *(
            (f"Table 7: {code} [kN]", lambda r, by: kilo(_paper(found, r["case"], by)["max"]), key)
            for key, code in PAPER
        ),
    )


@table_of("edulis_anchors")
def edulis_anchors(found: Found) -> Rows:
    """Edulis' anchors by heading of the tide."""

    def load(row: Found, name: str) -> str:
        return f"{1e-3 * row['largest_load_n'][name]:.2f} ({100 * row['utilisation'][name]:.1f})"

    anchors = ((f"{name} [kN] ([%])", load, name) for name in found["rows"][0]["largest_load_n"])
    return columns(found["rows"], ("heading [deg]", "{heading_deg}"), *anchors, ("moved [m]", "{moved_m:.1f}"))


@table_of("pitching")
def pitching(found: Found) -> Rows:
    """The paper's cases 1 to 3, upright and pitching, and case 1 without drag across the spar."""

    def motion(row: Found, key: str) -> str:
        return "{mean:.2f} / {std:.2f}".format(**row[key])

    return columns(
        (
            {**row, "note": note}
            for group, note in (("cases", ""), ("without_drag", ", no drag across"))
            for row in found[group]
        ),
        ("case", lambda r: r["case"].removeprefix("paper-case-")),
        ("spar", "{form}{note}"),
        ("anchor, mean / deviation / 99 % / largest [N]", _load, "anchor"),
        ("at the spar [N]", _load, "buoy"),
        ("surge, mean / deviation [m]", motion, "away_m"),
        ("heave of the base [m]", motion, "heave_m"),
        ("tilt, mean / deviation / largest [deg]", _tilt),
    )


@table_of("pitching")
def pitching_centres(found: Found) -> Rows:
    """Case 1 over the height of the centre of gravity."""
    return columns(
        found["centres"],
        (
            "centre of gravity above the base [m]",
            lambda r: f"{r['centre_m']:.4g}" + (" (homogeneous)" if r["centre_m"] > 4.0 else ""),
        ),
        (
            "natural period of pitch in calm water [s]",
            lambda r: "{pitch_period_s:.1f}".format(**r) if r["pitch_period_s"] else "it lies",
        ),
        ("tilt, mean / deviation / largest [deg]", _tilt),
        ("anchor, mean / deviation / 99 % / largest [N]", _load, "anchor"),
        ("beyond 60 degrees [% of time]", lambda r: f"{100 * r['capsized_share']:.0f}"),
    )


def _load(row: Found, end: str) -> str:
    load = row[f"{end}_n"]
    return joined((load["mean"], load["std"], row[f"{end}_99_n"], load["max"]), "{:.0f}", " / ")


def _tilt(row: Found) -> str:
    return "{mean:.0f} / {std:.0f} / {max:.0f}".format(**row["tilt_deg"]) if "tilt_deg" in row else "upright"
