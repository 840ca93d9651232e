"""Vessels of a scene as effects that move points."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import as_array
from dropper_jax.effects import Effect
from dropper_jax.effects.vessel_motion import VesselByTable, VesselInWaves
from dropper_jax.scene import SceneData, VesselSpec
from dropper_jax.sea import Sea


def make_vessels(scene: SceneData, sea: Sea | None) -> list[Effect]:
    """One moving point for each attachment of a vessel."""
    found = []
    for i, vessel in enumerate(scene.vessels):
        for name, position in vessel.attachments.items():
            found.append(_vessel_effect(vessel, f"vessel.{i}", name, position, scene, sea))
    return found


def _vessel_effect(
    vessel: VesselSpec, path: str, name: str, position: np.ndarray, scene: SceneData, sea: Sea | None
) -> Effect:
    if vessel.rao is None:
        return VesselByTable(
            time=as_array(vessel.time),
            motion=as_array(vessel.motion),
            arm=as_array(position),
            heading=as_array(vessel.heading),
            point=name,
        )
    # fraction of the wave energy that the RAO table must cover, and how far waves may be outside its headings [rad]
    covered = 0.95
    margin = 0.05
    if sea is None or sea.waves is None:
        raise SceneError(f"{path}.rao: needs waves; needed: [sea.waves]")
    waves = sea.waves
    omega = np.asarray(waves.omega, float)
    amplitude = np.asarray(waves.amplitude, float)
    course = np.broadcast_to(np.asarray(waves.direction, float), omega.shape) - vessel.heading
    table = vessel.rao.full_circle()
    energy = amplitude**2
    heading = table.nearest_turn(course)
    inside = (omega >= table.frequency[0] * (1 - 1e-9)) & (omega <= table.frequency[-1] * (1 + 1e-9))
    if np.sum(energy[inside]) < covered * np.sum(energy):
        raise SceneError(
            f"{path}.rao.frequency: {table.frequency[0]:.4g} to {table.frequency[-1]:.4g} rad/s leave out "
            f"{1 - np.sum(energy[inside]) / np.sum(energy):.0%} of the waves' energy; allowed: at most 5%"
        )
    aside = (heading < table.headings[0] - margin) | (heading > table.headings[-1] + margin)
    if np.sum(energy[aside]) > (1.0 - covered) * np.sum(energy):
        worst = heading[aside][np.argmax(energy[aside])]
        raise SceneError(
            f"{path}.rao.headings: waves come at {worst:.4g} rad to the vessel; allowed: {table.headings[0]:.4g} to "
            f"{table.headings[-1]:.4g} rad"
        )
    response = table.response(omega, heading)
    return VesselInWaves(
        real=as_array(response.real),
        imaginary=as_array(response.imag),
        place=as_array(vessel.position),
        arm=as_array(position),
        heading=as_array(vessel.heading),
        settled=as_array([0.0, scene.needed_sea.ramp]),
        point=name,
    )
