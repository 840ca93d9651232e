"""Other simulators on the scenes of this package, measured against the same reference (extra `peers`)."""

from __future__ import annotations

from typing import Any

from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.study.peers import diffrax_line, mujoco_chain
from dropper_jax.study.reference import Reference

__all__ = ["peer_rows"]


def peer_rows(
    scene: Scene, model: Model, s: State, target: Reference
) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    """Rows of MuJoCo and diffrax in the form of `work_precision.measure`, and omitted simulators with the reason."""
    rows, left = [], []
    for peer in (mujoco_chain, diffrax_line):
        reason = peer.refuse(model, s)
        if reason:
            left.append({"scheme": peer.NAME, "reason": reason})
        else:
            rows += peer.rows(model, s, target)
    return rows, left
