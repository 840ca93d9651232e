"""Tables of stability, accuracy, speed, sweeps, reports and films."""

from study import Found, Rows, columns, kilo, kilo_range, markdown, percent, table_of

BASELINES = ("thesis_angles 0.51", "thesis_angles 0.5", "theta 0.51", "theta 0.5")


def _baseline(row: Found, name: str) -> str:
    found = (row["baseline_thesis"] or {}).get(name)
    if found is None:
        return "-"
    if found["status"] != "ok":
        return f"{found['status']} at {found['failed_at_s']:.3g} s" if "failed_at_s" in found else found["status"]
    share = found["energy_drift_share"]
    return ("wrong" if found["wrong_energy"] else "ok") + ("" if share is None else f", energy {share:.0e}")


@table_of("stability")
def stability(found: Found) -> Rows:
    return columns(
        found["cases"],
        ("case", "{name}"),
        ("claim", "{claim}"),
        ("measured", lambda r: "-" if r["measured"] is None else "{measured:.1e} {unit}".format(**r)),
        ("limit", "{limit:.0e}"),
        ("holds", lambda r: "yes" if r["ok"] else "**no**"),
        *((name, _baseline, name) for name in BASELINES),
    )


@table_of("stability")
def thesis(found: Found) -> Rows:
    """The cases that the thesis' schemes were run on as well."""
    ran = lambda row: any(x["status"] not in ("refused", "not_run") for x in (row["baseline_thesis"] or {}).values())  # noqa: E731
    ours = lambda r: r["status"] + ("" if r["unit"] == "-" else f", {r['measured']:.0e} {r['unit']}")  # noqa: E731
    return columns(
        filter(ran, found["cases"]),
        ("case", "{name}"),
        ("energy_momentum", ours),
        *((name, _baseline, name) for name in BASELINES),
    )


@table_of("accuracy_north_sea")
def accuracy_north_sea(found: Found) -> str:
    def error(row: Found, name: str) -> str:
        return "-" if row[name] is None else f"{row[name]:.1e}"

    rows = columns(
        found["rows"],
        ("scheme", "{label}"),
        ("dt [s]", "{dt:.4g}"),
        ("RMS angle [rad]", error, "rms_angle_error_rad"),
        ("RMS position [m]", error, "rms_position_error_m"),
        ("tension [N]", error, "rms_tension_error_n"),
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
    return columns(
        (
            {"checked": words, "scenes": f"{len(found[group]['scenes'])} that it was {kind}", **found[group][mode]}
            for mode, words in (("whole", "the whole run"), ("stretches", "stretches"))
            for group, kind in (("tuned", "tuned on"), ("judged", "judged by"))
        ),
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

    def end(goal: Found, name: str) -> str:
        ours, peer = (goal[name][key].split(",")[0] for key in ("ours", "peer"))
        return f"{goal[name]['ratio']:.2g} at {goal[name]['error_m']:.0e} m ({ours} against {peer})"

    return columns(
        ({"scene": scene["scene"], **goal} for scene in found["scenes"] for goal in scene["goals"]),
        ("line", "{scene}"),
        ("against", "{goal}"),
        ("goal", "{wanted:g}"),
        ("minimum", end, "least"),
        ("maximum", end, "largest"),
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
    def load(row: Found, name: str) -> str:
        agree = row[f"{name} agrees"]
        return f"{100 * row[name]:.2g} %" + ("" if agree == row["lines"] else f" ({agree} of {row['lines']})")

    return columns(
        ({"scene": scene, **row} for scene, steps in found["scenes"].items() for row in steps),
        ("scene", "{scene}"),
        ("step [s]", "{dt:.3g}"),
        ("mean", load, "mean"),
        ("deviation", load, "deviation"),
        ("99.9 % in time", load, "quantile"),
        ("mean of windows' maxima", load, "window maximum"),
        ("largest", lambda r: f"{100 * r['largest']:.2g} %"),
    )


@table_of("sweep", "sweep_gpu")
def sweep(found: Found, on_gpu: Found) -> str:
    """Throughput of a sweep of the lab dropper, saving included."""
    cores = {"on": f"{found['machine']['cores']} cores"}
    rows = columns(
        [row | cores for row in found["rows"]] + [row | {"on": on_gpu["device"]} for row in on_gpu["rows"]],
        ("on", "{on}"),
        ("cases", "{cases}"),
        ("steps of each", "{steps_per_case}"),
        ("until compiled [s]", "{compile_s:.1f}"),
        ("run and saved [s]", "{run_s:.2f}"),
        ("million steps per second", "{million_steps_per_s:.1f}"),
        ("memory at most [MB]", "{peak_memory_mb:.0f}"),
    )
    single, ratio = found["single_runs_million_steps_per_s"], found["times_faster_than_single_runs"]
    return (
        f"{markdown(rows)}\n\nOn {cores['on']} a loop over single runs makes {single:.2g} million "
        f"steps per second: the sweep is {ratio:.0f} times as fast."
    )


@table_of("sweep_truths")
def sweep_truths(found: Found) -> str:
    """Where the true pair of Table E.1 is among the fifteen, by part and measure, and the fit of the same trace."""
    parts = ("head", "middle", "tail")

    def rank(row: Found, part: str) -> str:
        """The error, and the rank where it is not the first."""
        angle = row[part]["angle"]
        return f"{1e3 * angle['true']:.2f}" + ("" if angle["rank"] == 1 else f" (rank {angle['rank']})")

    def fitted(row: Found, i: int) -> str:
        return f"{row['fit']['values'][i]:.4g} +- {row['fit']['std_errors'][i]:.1g}"

    rows = columns(
        found["rows"],
        ("truth: b_l [kg/s], b_q [kg/m]", "{b_l:g}, {b_q:g}"),
        *((part, rank, part) for part in parts),
        ("best other pair, head", lambda r: f"{1e3 * r['head']['angle']['other']:.2f}"),
        ("fitted b_l", fitted, 0),
        ("fitted b_q", fitted, 1),
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
        ("largest tension [kN]", lambda r: kilo(r["largest_n"])),
        ("snaps, worst link", "{snaps}"),
        ("equivalent range [kN]", lambda r: kilo(r["equivalent_range_n"])),
        ("damage per year", "{damage_per_year:.1f}"),
        ("steps retried", "{retried}"),
    )
    keys = ("mean_anchor_n", "largest_n", "damage_per_year")
    series = ([row[key] for row in found["damping"]] for key in keys)
    mean, largest, damage = (max(values) / min(values) for values in series)
    return (
        f"{markdown(rows)}\n\nThe mean load agrees within {percent(mean - 1, 1)}. The largest tension differs by a "
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
        ("largest of each run [kN]", lambda r: kilo_range(r["maxima"])),
        *(
            (f"{word}, 90 % interval [kN]", lambda r, key=key: f"{kilo(r[key][0])}, {kilo_range(r[key][1:])}")
            for key, word in kinds.items()
        ),
    )
    return (
        f"{markdown(rows)}\n\nThe largest tension of {storm['further_seeds']} further seeds, which make up 3 h, is "
        f"{kilo(storm['further_largest_n'])} kN. Steps retried in a run: at most {storm['retried']}."
    )


@table_of("films")
def films(found: Found) -> str:
    """Films of known motion, tracked with boards and without."""

    def if_known(row: Found, form: str) -> str:
        return form.format(**row).replace("%", " %") if "rms_mrad" in row else "-"

    def order(row: Found) -> str:
        return "not known, exit 3" if "rms_mrad" not in row else "right" if row["right_order"] else "**wrong**"

    rows = columns(
        found["films"],
        ("film", "{film}"),
        ("boards", lambda r: "yes" if r["calibrated"] else "no"),
        ("order", order),
        ("RMS error [mrad]", if_known, "{rms_mrad:.2f}"),
        ("maximum [mrad]", if_known, "{largest_mrad:.1f}"),
        ("stated over true error", if_known, "{stated_over_true:.2f}"),
        ("of each link", if_known, "{of_links[0]:.2f} to {of_links[1]:.2f}"),
        ("left empty", if_known, "{empty_share:.1%}"),
        ("marked", if_known, "{marked_share:.1%}"),
    )
    total = {key: sum(row[key] for row in found["marks"]) for key in found["marks"][0] if key != "film"}
    share = lambda part, whole: percent(total[part] / total[whole], 1)  # noqa: E731
    return (
        f"{markdown(rows)}\n\nOf {total['swapped']} frames in which two nodes were made to swap names "
        f"{share('swapped_found', 'swapped')} are marked, of {total['jumped']} in which one was shifted by 0.2 to 1 "
        f"link {share('jumped_found', 'jumped')}, of {total['well']} others {share('well_marked', 'well')}."
    )
