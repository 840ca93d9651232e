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


@table_of()
def published_crops() -> Rows:
    """Published values of crops, as `dropper library` has them."""
    found = library.published_crops()
    keys = ("mass", "outer_diameter", "cdn", "can", "EI")
    head = ("published crop", "mass [kg/m]", "outer diameter [m]", "C_D", "C_A", "EI [N m2]", "source", "read")
    cells = [["-" if crop[key] is None else f"{crop[key]:g}" for key in keys] for crop in found]
    return [head, *((c["crop"], *row, c["source"], c["read"]) for c, row in zip(found, cells, strict=True))]
