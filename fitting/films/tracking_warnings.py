"""Status of a tracked film, and lines on what its trace lacks and why."""

from __future__ import annotations

import numpy as np

from fitting.films.chain_check import LARGEST_ERROR, why_no_chain
from fitting.films.marks import Marks
from fitting.films.tracked import longest_gaps
from fitting.films.tracked_chain import TrackedChain
from fitting.films.video import Video

#: A marker not detected for longer [s] at the end is lost; one that reappears may have turned round unseen.
LONGEST_GAP = 0.5
#: Meaning of the marks.
WORDS = {"swapped": "swapped", "jumped": "jumped", "length": "off the lengths of their links"}


def tracking_status(film: Video, chain: TrackedChain, marks: Marks, error: np.ndarray, ending: str) -> tuple[str, str]:
    """Status of a result and its reason.

    Args:
        error: of the angles (k, n - 1) [rad].
        ending: why the trace ends early; empty if it does not.
    """
    lost = why_no_chain(chain.where_detected(chain.flat), marks, error)
    if lost:
        return "lost", (
            f"{film.path.name}: the circles do not move as the nodes of a chain: {lost}; needed: a marker on each of "
            f"{chain.detected.shape[1]} nodes (--overlay shows what was followed, --radius and --marker describe the "
            "markers)"
        )
    if ending:
        return "not_converged", ending
    return "ok", ""


def tracking_warnings(
    film: Video,
    chain: TrackedChain,
    marks: Marks,
    depth: tuple[str, ...],
    t: np.ndarray,
    offset: int,
    uncertain: int,
) -> tuple[str, ...]:
    """Lines on what the trace lacks and why.

    Args:
        depth: lines on motion out of the plane.
        t: times of the trace [s], which starts at frame `offset`.
        uncertain: number of angles that are left empty because of their errors.
    """
    detected = chain.detected
    found = []
    if offset:
        found.append(f"no link is visible before frame {offset}; the trace starts there")
    if chain.straight:
        found.append("no joint bends; the nodes are ordered as they lie on a line")
    found += depth
    if uncertain:
        found.append(f"{uncertain} angles with standard errors above {LARGEST_ERROR:g} rad left empty")
    gaps = longest_gaps(detected) / film.fps
    for node in np.flatnonzero((~detected).any(axis=0)):
        long = ""
        if gaps[node] > LONGEST_GAP:
            long = f"; the longest gap is {gaps[node]:.2g} s, turns in it are not counted"
        found.append(f"marker {node} not seen in {(~detected[:, node]).sum()} frames, bridged and left empty{long}")
    for span in marks.spans(t):
        when = " to ".join(dict.fromkeys(f"{span[key]:.4g}" for key in ("from_s", "to_s")))
        nodes = ", ".join(map(str, span["nodes"]))
        why = " and ".join(WORDS[word] for word in span["why"])
        found.append(f"{when} s: nodes {nodes} {why}; marked and left empty")
    return tuple(f"{film.path.name}: {line}" for line in found)
