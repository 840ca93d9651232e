"""MoorDyn v2 on the hard cases whose claim is about the path of a point, with rk2 at the case's step and its default.

    python benchmarks/moordyn_hard_cases.py [NAME ...]

Needs the extra `moordyn`; takes about five minutes. Writes results/moordyn_hard_cases.json.
"""

from moordyn_point import SCHEMES, run_point
from study import Found, Rows, collect, columns, command, table_of

from dropper_jax.study.stability import all_cases


def compare(names: list[str]) -> list[Found]:
    """A row of each case that MoorDyn can be given: what is measured here and there."""
    rows = []
    for case in all_cases():
        if names and case.name not in names:
            continue
        found = case.measure(False)
        if found.watched is not None:
            theirs = {label: measured(found.watched, case.limit, scheme) for label, scheme in SCHEMES.items()}
            head = {"name": case.name, "measured": found.measured, "unit": case.unit, "limit": case.limit}
            rows.append({**head, "moordyn": theirs})
    return rows


def measured(watched, limit: float, scheme: str | None) -> Found:
    """MoorDyn on a case: {status, measured, holds}, with `failed_at_s` if the run did not complete."""
    run = run_point(watched.scene, watched.point, watched.dt, watched.duration, scheme, watched.drive)
    if not run.ok:
        return {"status": "unstable", "failed_at_s": float(watched.dt * len(run.t)), "holds": False}
    value = float(watched.measure(run.t, run.positions))
    return {"status": "ok", "measured": value, "holds": value <= limit}


@table_of("moordyn_hard_cases")
def moordyn_hard_cases(found: Found) -> Rows:
    return columns(
        found["cases"],
        ("case", "{name}"),
        ("here", "{measured:.0e} {unit}"),
        ("limit", "{limit:.0e}"),
        *((label, _cell, label) for label in SCHEMES),
    )


def _cell(row: Found, label: str) -> str:
    found = row["moordyn"][label]
    if found["status"] != "ok":
        return f"{found['status']} at {found['failed_at_s']:.3g} s"
    return f"{'holds' if found['holds'] else 'wrong'}, {found['measured']:.0e}"


@command({"names": [str]})
def main(args) -> None:
    collect("moordyn_hard_cases", {"cases": compare(args.names)}, by="name", schema=1)
