"""Tables of stability, accuracy, speed, sweeps, reports and films."""

from study import Found, Rows, columns, markdown, table_of

BASELINES = ("thesis_angles 0.51", "thesis_angles 0.5", "theta 0.51", "theta 0.5")


def _baseline(row: Found, name: str) -> str:
    found = (row["baseline_thesis"] or {}).get(name)
    if found is None:
        return "-"
    if found["status"] != "ok":
        if "failed_at_s" in found:
            return f"{found['status']} at {found['failed_at_s']:.3g} s"
        return found["status"]
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


@table_of("accuracy_north_sea")
def accuracy_north_sea(found: Found) -> str:
    def error(row: Found, name: str) -> str:
        if row[name] is None:
            return "-"
        return f"{row[name]:.1e}"

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
