"""Tables of the paper's cases."""

from study import Found, Rows, columns, joined, table_of

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

    def row(name: str, loads: dict[int, Found | str]) -> tuple[str, ...]:
        """Means of loads less those of the base, or why there are none, by case; the largest load of case 4."""
        whole = {number: load for number, load in loads.items() if not isinstance(load, str)}
        cells = {number: f"{load['mean'] - mean[number]:+.0f}" for number, load in whole.items()}
        largest = f"{whole[4]['max']:.0f}" if 4 in whole else "-"
        return name, *(cells.get(n, loads.get(n, "-")) for n in NUMBERS), largest

    rows = [
        ("one change", *(f"case {number}, mean [N]" for number in NUMBERS), "case 4, largest [N]"),
        ("none: from Table 6, 150 s", *(f"{mean[n]:.0f}" for n in NUMBERS), f"{base[4]['anchor']['max']:.0f}"),
    ]
    for name in dict.fromkeys(one["convention"] for one in found["conventions"]):
        own = (one for one in found["conventions"] if one["convention"] == name)
        loads = {one["case"]: one["spans"][0]["anchor"] if one["spans"] else one["status"].split(" ")[0] for one in own}
        rows.append(row(name, loads))
    node = "force on the anchor's node, not tension of its link"
    rows.append(row(node, {n: base[n]["anchor_node"] for n in NUMBERS}))
    for ratio in dict.fromkeys(one["damping_ratio"] for one in found["moordyn"]):
        own = [one for one in found["moordyn"] if one["damping_ratio"] == ratio]
        signed = {one["case"]: one["anchor"] if one["status"] == "ok" else one["status"] for one in own}
        sizes = {number: load if isinstance(load, str) else load["size"] for number, load in signed.items()}
        rows.append(row(f"MoorDyn v2, damping ratio {ratio:g}", signed))
        rows.append(row(f"MoorDyn v2, damping ratio {ratio:g}, pushing counted as pulling", sizes))
    for key, code in PAPER:
        paper = {n: dict(zip(("min", "mean", "max"), found["table_7"][str(n)][key], strict=True)) for n in NUMBERS}
        rows.append(row(f"Table 7: {code}", paper))
    for span in (50.0, 200.0):
        rows.append(row(f"{span:g} s instead of 150 s", {n: _span(found, n, span)["anchor"] for n in NUMBERS}))
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


@table_of("table7")
def table7_edulis(found: Found) -> Rows:
    """Edulis in both codes."""

    def number(row: Found, value: float) -> str:
        return f"{value:.0f}" if row["mean"]["here"] > 100.0 else f"{value:.2f}"

    def here(row: Found, what: str) -> str:
        one = row[what]
        error = one["step"] + one["links"]
        return f"{number(row, one['here'])} ± {number(row, error)} ({number(row, one['chance'])})"

    def there(row: Found, what: str) -> str:
        return f"{number(row, row[what]['moordyn'])} ± {number(row, row[what]['moordyn_step'])}"

    return columns(
        (row for row in found["edulis"]["rows"] if row["deviation"]["here"] >= UNMOVED),
        ("", lambda r: f"{r['name']} {'[N]' if r['mean']['here'] > 100.0 else '[m]'}"),
        ("mean, here", here, "mean"),
        ("mean, MoorDyn v2", there, "mean"),
        ("deviation, here", here, "deviation"),
        ("deviation, MoorDyn v2", there, "deviation"),
        ("largest, here / MoorDyn v2", lambda r: f"{number(r, r['max']['here'])} / {number(r, r['max']['moordyn'])}"),
    )


@table_of("table7_peaks")
def table7_peaks(found: Found) -> Rows:
    """Largest anchor tension by scheme and step, the range over moved starts, and the paper's two codes."""
    schemes = list(dict.fromkeys(row["scheme"] for row in found["rows"]))
    kilo = lambda newton: f"{1e-3 * newton:.1f}" if newton >= 1e4 else f"{1e-3 * newton:.2f}"  # noqa: E731

    def at(case: Found, scheme: str) -> str:
        own = (r for r in case["runs"] if r["moved_m"] == 0.0 and r["scheme"] == scheme)
        return ", ".join(f"{kilo(r['anchor']['max'])} ({1e3 * r['dt_s']:.3g})" for r in own) or "-"

    def paper(case: Found, code: str) -> str:
        return kilo(found["table_7"][str(case["case"])][code][2])

    def moved(case: Found) -> str:
        tops = [r["anchor"]["max"] for r in case["runs"] if r["moved_m"] != 0.0]
        return f"{kilo(min(tops))} to {kilo(max(tops))} ({len(tops)})" if tops else "-"

    good = [row for row in found["rows"] if row["status"] == "ok"]
    return columns(
        ({"case": n, "runs": [row for row in good if row["case"] == n]} for n in NUMBERS),
        ("case", "{case}"),
        *((f"{scheme} [kN] (step [ms])", at, scheme) for scheme in schemes),
        ("starts moved by up to 1e-6 m [kN]", moved),
        *((f"Table 7: {code} [kN]", paper, key) for key, code in PAPER),
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
    period = lambda seconds: "it lies" if seconds is None else f"{seconds:.1f}"  # noqa: E731
    return columns(
        found["centres"],
        (
            "centre of gravity above the base [m]",
            lambda r: f"{r['centre_m']:.4g}" + (" (homogeneous)" if r["centre_m"] > 4.0 else ""),
        ),
        ("natural period of pitch in calm water [s]", lambda r: period(r["pitch_period_s"])),
        ("tilt, mean / deviation / largest [deg]", _tilt),
        ("anchor, mean / deviation / 99 % / largest [N]", _load, "anchor"),
        ("beyond 60 degrees [% of time]", lambda r: f"{100 * r['capsized_share']:.0f}"),
    )


def _load(row: Found, end: str) -> str:
    load = row[f"{end}_n"]
    return joined((load["mean"], load["std"], row[f"{end}_99_n"], load["max"]), "{:.0f}", " / ")


def _tilt(row: Found) -> str:
    return "{mean:.0f} / {std:.0f} / {max:.0f}".format(**row["tilt_deg"]) if "tilt_deg" in row else "upright"
