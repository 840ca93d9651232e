"""Vessels of a scene as effects that move points."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import as_array
from dropper_jax.effects import Effect
from dropper_jax.effects.vessel_motion import VesselByTable, VesselInWaves
from dropper_jax.scene import RaoSpec, SceneData
from dropper_jax.sea import Sea

#: Fraction of the wave energy that the RAO table must cover, and how far waves may be outside its headings [rad].
COVERED = 0.95
MARGIN = 0.05


def make_vessels(scene: SceneData, sea: Sea | None) -> list[Effect]:
    """One moving point for each attachment of a vessel."""
    found = []
    for i, vessel in enumerate(scene.vessels):
        if vessel.rao is None:
            kind = VesselByTable
            motion = {"time": as_array(vessel.time), "motion": as_array(vessel.motion)}
        else:
            response = _response(vessel.rao, vessel.heading, f"vessel.{i}.rao", sea)
            kind = VesselInWaves
            motion = {
                "real": as_array(response.real),
                "imaginary": as_array(response.imag),
                "position": as_array(vessel.position),
                "ramp_times": as_array([0.0, scene.needed_sea.ramp]),
            }
        heading = as_array(vessel.heading)
        for name, position in vessel.attachments.items():
            found.append(kind(**motion, arm=as_array(position), heading=heading, point=name))
    return found


def _response(rao: RaoSpec, course: float, path: str, sea: Sea | None) -> np.ndarray:
    """Response of a vessel with this heading [rad] to each of the waves, as of `RaoSpec.response`.

    Raises:
        SceneError: no waves, or waves outside of the table.
    """
    if sea is None or sea.waves is None:
        raise SceneError(f"{path}: needs waves; needed: [sea.waves]")
    omega = np.asarray(sea.waves.omega, float)
    energy = np.asarray(sea.waves.amplitude, float) ** 2
    table = rao.full_circle()
    heading = table.nearest_turn(np.broadcast_to(np.asarray(sea.waves.direction, float), omega.shape) - course)
    low, high = table.frequency[[0, -1]]
    inside = (omega >= low * (1 - 1e-9)) & (omega <= high * (1 + 1e-9))
    left_out = np.sum(energy[~inside])
    if left_out > (1.0 - COVERED) * np.sum(energy):
        raise SceneError(
            f"{path}.frequency: {low:.4g} to {high:.4g} rad/s leave out {left_out / np.sum(energy):.0%} of the waves' "
            f"energy; allowed: at most {1.0 - COVERED:.0%}"
        )
    low, high = table.headings[[0, -1]]
    aside = (heading < low - MARGIN) | (heading > high + MARGIN)
    if np.sum(energy[aside]) > (1.0 - COVERED) * np.sum(energy):
        worst = heading[aside][np.argmax(energy[aside])]
        raise SceneError(
            f"{path}.headings: waves come at {worst:.4g} rad to the vessel; allowed: {low:.4g} to {high:.4g} rad"
        )
    return table.response(omega, heading)
