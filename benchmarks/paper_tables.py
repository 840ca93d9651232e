"""Tables of the paper's cases."""

from collections.abc import Callable

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
