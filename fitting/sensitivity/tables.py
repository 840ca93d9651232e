"""Sensitivities as text for the terminal."""

from __future__ import annotations

import numpy as np

from dropper_jax.cli.output import listing, table
from fitting.sensitivity.derivatives import Local
from fitting.sensitivity.screening import Global


def local_text(found: Local) -> str:
    """Derivatives as text, the largest first, and their range of validity."""
    order = np.argsort(-np.abs(found.scaled if np.isfinite(found.scaled).all() else found.forward))
    head = ["parameter", "value", "dQ/dp", "p/Q dQ/dp"]
    windowed = not found.trusted
    rows = [head + (["window mean", "std error"] if windowed else [])]
    for i in order:
        row = [
            found.names[i],
            f"{found.values[i]:.5g} {found.units[i]}",
            f"{found.forward[i]:.6g}",
            f"{found.scaled[i]:.4g}",
        ]
        rows.append(row + ([f"{found.window_mean[i]:.5g}", f"{found.window_error[i]:.2g}"] if windowed else []))
    trust = (
        "the whole run"
        if found.trusted
        else f"up to {found.horizon:.3g} s only: beyond, small changes grow more than 100 times"
    )
    rate = "" if found.exponent is None else f" (growth rate {found.exponent:.2g} per s)"
    pairs = [
        ("quantity", f"{found.of} = {found.value:.6g} {found.unit} over {found.duration:g} s"),
        ("trust", f"{trust}{rate}"),
    ]
    if found.mismatch is not None:
        pairs.append(("modes", f"forward and reverse differ by {found.mismatch:.1e}"))
    if windowed:
        pairs.append(("windows", f"of {found.window:.3g} s: the quantity of each, averaged over the motion"))
    return f"{listing(pairs)}\n\n{table(rows)}"


def global_text(found: Global, of: str) -> str:
    """Indices as text, the largest first."""
    sobol = found.method == "sobol"
    rows = [
        [
            "parameter",
            "from",
            "to",
            *(("first", "+-", "total", "+-") if sobol else ("mean |effect|", "+-", "spread", "")),
        ]
    ]
    for i in np.argsort(-found.total if sobol else -found.first):
        numbers = (found.first[i], found.first_error[i], found.total[i], found.total_error[i])
        cells = ["" if np.isnan(x) else f"{x:.3g}" for x in numbers]
        rows.append([found.names[i], *(f"{x:.4g}" for x in found.ranges[i]), *cells])
    return f"{of}: {found.runs} runs, mean {found.mean:.5g}, standard deviation {found.std:.3g}\n\n{table(rows)}"
