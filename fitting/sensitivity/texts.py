"""Results of local and global studies as text."""

from __future__ import annotations

import numpy as np

from dropper_jax.cli.printing import listing, table
from fitting.sensitivity.global_indices import GlobalIndices
from fitting.sensitivity.result import OF_RUNS, LocalDerivatives

#: What grows over a run, in words, by `Local.grows`.
GROWTH_WORDS = {
    "tangent": "tangent: small changes grow, those of engineering size do not; `jax.grad` of this run is of no use",
    "motion": "motion: it is chaotic, so only means and distributions have slopes",
}
#: Error at 95 % of an index, as a fraction of the variance, above which the order of the parameters is chance.
WIDE_INTERVAL = 0.2


def local_text(found: LocalDerivatives) -> str:
    """Derivatives as text, the largest first, and their range of validity."""
    scaled = np.isfinite(found.scaled[found.resolved]).all()
    slopes = found.scaled if scaled else found.forward
    columns = {
        "parameter p": found.names,
        "value": [f"{x:.5g} {unit}" for x, unit in zip(found.values, found.units, strict=True)],
        f"dQ/dp [{found.unit} per unit of p]": slope_cells(found, found.forward, ".6g", "not resolved"),
        "p/Q dQ/dp [% per %]": slope_cells(found, found.scaled, ".4g", ""),
    }
    if found.error is not None:
        columns["error of dQ/dp"] = slope_cells(found, found.error, ".2g", "")
    if found.unclear:
        columns["status"] = [status.replace("_", " ") for status in found.slope_status]
    if found.window_mean is not None and found.window_error is not None:
        columns["window mean"] = [f"{x:.5g}" for x in found.window_mean]
        columns["std error"] = [f"{x:.2g}" for x in found.window_error]
    lines = list(zip(*columns.values(), strict=True))
    rows = [list(columns), *(lines[i] for i in np.argsort(-np.abs(slopes)))]  # those that are not resolved come last
    return f"{listing(local_facts(found))}\n\n{table(rows)}"


def local_facts(found: LocalDerivatives) -> list[tuple[str, str]]:
    """Names and values of the lines above the table: the quantity, and how far its derivatives are valid."""
    rate = "" if found.exponent is None else f" (growth rate {found.exponent:.2g} per s)"
    error = f" +- {found.value_error:.2g}" if np.isfinite(found.value_error) else ""
    pairs = [
        ("quantity Q", f"{found.of} = {found.value:.6g}{error} {found.unit} over {found.duration:g} s"),
        ("derivatives valid", f"{validity_in_words(found)}{rate}"),
    ]
    if found.along is not None:
        share = f"two runs at 1 % change the quantity by {found.along.ratio:.3g} of what they predict"
        pairs.append(("along them", f"{share}: {found.along.status}"))
    if found.method == OF_RUNS:
        sizes = "1 % of a parameter (0.6 % of a length), error from 0.3 % (0.2 %) and rounding"
        pairs.append(("method", f"differences of runs by {sizes}"))
    if found.grows != "nothing":
        pairs.append(("grows", GROWTH_WORDS[found.grows]))
    if found.mismatch is not None:
        pairs.append(("modes", f"forward and reverse differ by {found.mismatch:.1e}"))
    if found.window is not None:
        pairs.append(("windows", f"of {found.window:.3g} s: the quantity of each, averaged over the motion"))
    return pairs


def slope_cells(found: LocalDerivatives, numbers: np.ndarray, form: str, otherwise: str) -> list[str]:
    """Numbers (p,) as text; `otherwise` where the slope is not resolved."""
    cells = np.array([f"{x:{form}}" for x in numbers])
    return np.where(found.resolved, cells, otherwise).tolist()


def validity_in_words(found: LocalDerivatives) -> str:
    """Where the derivatives are valid, in words."""
    if found.window is not None:
        return f"up to {found.horizon:.3g} s only: beyond, they predict over 10 % of the motion for 1 % of a parameter"
    if found.unclear:
        return f"not by {', '.join(found.unclear)}: see the warnings"
    return "over the whole run"


def global_text(found: GlobalIndices, of: str) -> str:
    """Indices as text, the largest first."""
    sobol = found.method == "sobol"
    heads = ("mean |effect|", "+-", "spread", "")
    sizes = found.first
    if sobol:
        heads = ("first", "+-", "total", "+-")
        sizes = found.total
    rows = [["parameter", "from", "to", *heads]]
    for i in np.argsort(-sizes):
        row = [found.names[i], *(f"{x:.4g}" for x in found.ranges[i])]
        for x in (found.first[i], found.first_error[i], found.total[i], found.total_error[i]):
            cell = "" if np.isnan(x) else f"{x:.3g}"
            row.append(cell)
        rows.append(row)
    text = f"{of}: {found.runs} runs, mean {found.mean:.5g}, standard deviation {found.std:.3g}\n\n{table(rows)}"
    if sobol and np.max(found.total_error) > WIDE_INTERVAL:
        more = 4 * found.runs // (len(found.names) + 2)  # errors go with the root of the number of samples
        text += f"\n\nintervals of +-{np.max(found.total_error):.2g} are wide; --samples {more} halves them"
    return text
