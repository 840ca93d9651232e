"""Tables of the sources, the thesis and the sea."""

from study import Found, Rows, columns, markdown, percent, table_of

from dropper_jax.load import library


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
    """Scenarios from the thesis' ramps and from their packaged poses, by the default scheme and by the thesis' own."""
    dampings = [(row["b_l"], row["b_q"]) for row in found["scenarios"][0]["ramp"]["thesis_angles"]]
    starts = (("ramp", "force until 15 s"), ("ramp-14", "force until 14.1 s"), ("pose", "packaged pose"))
    ended = "{status}, {reached_s:.2f} s"
    return columns(
        (
            {"start": f"{row['scenario']}, {words}", **row[start]}
            for row in found["scenarios"]
            for start, words in starts
            if start in row
        ),
        ("scenario, start", "{start}"),
        (
            "angles before the release, RMS to the thesis' model [rad]",
            lambda r: "{rms_to_model_rad:.3f}".format(**r) if "rms_to_model_rad" in r else "no angles given",
        ),
        ("energy_momentum", lambda r: ended.format(**r["default"])),
        *(
            (
                f"thesis_angles, b_l {b_l:g} kg/s, b_q {b_q:g} kg/m",
                lambda r, i: ended.format(**r["thesis_angles"][i]),
                i,
            )
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
        ("energy not accounted for", lambda r: percent(r["energy_share"], 0 if r["energy_share"] >= 0.1 else 1)),
    )
    ran = "; ".join(
        "at {dt_s:g} s corrected to {corrected:.3f} s, as printed to {printed:.3f} s".format(**row)
        for row in found["independent"]
    )
    return f"{markdown(rows)}\n\nIn NumPy (C.32)-(C.41) in the plane run, undamped, {ran}."


@table_of("north_sea")
def north_sea(found: Found) -> Rows:
    """Angles, tensions and speeds of the dropper in the North Sea, effect by effect."""

    def between(row: Found, key: str, digits: int = 2) -> str:
        """The value of several runs where they agree to the digits that are printed, else from the least on."""
        values = [run[key] for run in row["runs"]]
        if None in values:
            return "-"
        return " to ".join(dict.fromkeys(f"{value:.{digits}f}" for value in (min(values), max(values))))

    def ended(row: Found) -> str:
        early = "{status} after {duration_s:.2f} s"
        return ", ".join(sorted({"ok" if r["status"] == "ok" else early.format(**r) for r in row["runs"]}))

    return columns(
        found["rows"],
        ("effects", "{name}"),
        ("minimum polar [rad]", between, "polar_min_rad"),
        ("maximum", between, "polar_max_rad"),
        ("maximum azimuth [rad]", between, "azimuth_max_rad"),
        ("peak [Hz]", between, "azimuth_peak_hz"),
        ("first link at most [N]", between, "tension_first_max_n", 0),
        ("last", between, "tension_last_max_n", 0),
        ("minimum [N]", between, "tension_min_n", 0),
        ("fastest [m/s]", between, "speed_max_m_s", 1),
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


@table_of()
def published_crops() -> Rows:
    """Published values of crops, as `dropper library` has them."""
    found = library.published_crops()
    keys = ("mass", "outer_diameter", "cdn", "can", "EI")
    head = ("published crop", "mass [kg/m]", "outer diameter [m]", "C_D", "C_A", "EI [N m2]", "source", "read")
    cells = [["-" if crop[key] is None else f"{crop[key]:g}" for key in keys] for crop in found]
    return [head, *((c["crop"], *row, c["source"], c["read"]) for c, row in zip(found, cells, strict=True))]


@table_of("standards")
def worked_standards(found: Found) -> Rows:
    """Two worked examples: every number of the report's page with the edition and clause that it comes from."""
    rows = [("example", "number in the report", "value", "edition, clause", "compared with")]
    for name, example in found.items():
        own = example["standard"]
        pairs = "; ".join(f"waves of {waves}, current of {current} years" for waves, current in own["pairs"])
        rows.append((f"`{name}`", "return periods", pairs, f"{own['edition']}, {own['clause']}", own["checked"]))
        for part in example["parts"]:
            value = "{factor:g} x {load_n:.0f} / {capacity_n:.0f} = {utilisation:.3f}".format(**part)
            number = f"utilisation of {part['part']}: factor, load and capacity [N] ({part['case']})"
            source = part["factors"]
            rows.append(("", number, value, f"{source['edition']}, {source['clause']}", source["checked"]))
    return rows
