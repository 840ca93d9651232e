"""Axial laws: the relation between the length of a link and its tension; one file each."""

from __future__ import annotations

from collections.abc import Callable

from dropper_jax.axial.changing_length import LENGTH_IN_TIME, ChangingLength
from dropper_jax.axial.damped_rope import DampedRope
from dropper_jax.axial.elastic import AXIAL_RINGING, Elastic
from dropper_jax.axial.groups import Groups
from dropper_jax.axial.law import AxialLaw, LinkStart, SlackTangent, Works, sum_works
from dropper_jax.axial.rigid import Rigid
from dropper_jax.axial.rope import Rope
from dropper_jax.axial.tabulated import Tabulated

#: Class of each law by its name in a scene.
LAWS: dict[str, Callable[..., AxialLaw]] = {
    "rigid": Rigid,
    "elastic": Elastic,
    "rope": Rope,
    "damped_rope": DampedRope,
    "tabulated": Tabulated,
}
#: Laws of links that stretch, in words.
STRETCHING_LAWS = ", ".join(name for name in LAWS if name != "rigid")

__all__ = [
    "AXIAL_RINGING",
    "LAWS",
    "LENGTH_IN_TIME",
    "STRETCHING_LAWS",
    "AxialLaw",
    "ChangingLength",
    "DampedRope",
    "Elastic",
    "Groups",
    "LinkStart",
    "Rigid",
    "Rope",
    "SlackTangent",
    "Tabulated",
    "Works",
    "sum_works",
]
