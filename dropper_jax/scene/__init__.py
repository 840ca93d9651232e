"""The scene as data: the user's description."""

from dropper_jax.scene.anchor import AnchorSpec, check_anchors, utilisations
from dropper_jax.scene.body import BodySpec, CylinderSpec, SphereSpec, attitude
from dropper_jax.scene.data import SceneData, link_mass_words
from dropper_jax.scene.failure import FailureSpec
from dropper_jax.scene.fit import FitSpec, PriorSpec, SensorSpec
from dropper_jax.scene.growth import GrowthSpec, grown
from dropper_jax.scene.line import LineSpec, join_lines
from dropper_jax.scene.point import BuoySpec, PointSpec
from dropper_jax.scene.run import RunSpec, choose_steps
from dropper_jax.scene.season import SeasonSpec
from dropper_jax.scene.slices import LineSlice, WholeLine, line_offsets, line_slices, sliced_lines, whole_lines
from dropper_jax.scene.start import StartSpec, directions
from dropper_jax.scene.vessel import RaoSpec, VesselSpec

__all__ = [
    "AnchorSpec",
    "BodySpec",
    "BuoySpec",
    "CylinderSpec",
    "FailureSpec",
    "FitSpec",
    "GrowthSpec",
    "LineSlice",
    "LineSpec",
    "PointSpec",
    "PriorSpec",
    "RaoSpec",
    "RunSpec",
    "SceneData",
    "SeasonSpec",
    "SensorSpec",
    "SphereSpec",
    "StartSpec",
    "VesselSpec",
    "WholeLine",
    "attitude",
    "check_anchors",
    "choose_steps",
    "directions",
    "grown",
    "link_mass_words",
    "join_lines",
    "line_offsets",
    "line_slices",
    "sliced_lines",
    "utilisations",
    "whole_lines",
]
