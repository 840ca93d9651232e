"""Synthetic traces with known truth: a simulated run, observed by a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax import load_scene, make_stepper
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import SceneLike, build
from dropper_jax.residual import Stepper
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import Trajectory, begin
from fitting.traces.trace import Convention, Trace


@dataclass(frozen=True)
class Camera:
    """Observation of a run.

    Attributes:
        rate: frames per second [Hz].
        angle_noise: white noise of the angles [rad].
        pixel_noise: white noise of every node's image [pixel]; the noise of each link's angle is then about
            `pixel_noise sqrt(2) pixel/L`, correlated between neighbours, which share a node.
        pixel: size of a pixel at the dropper [m].
        offset: rotation of the camera [rad].
        outliers: fraction of samples that are wrong by up to half a radian.
        missing: fraction of samples that are lost.
        delay: time of the first frame after the release [s].
    """

    rate: float = 60.0
    angle_noise: float = 0.0
    pixel_noise: float = 0.0
    pixel: float = 0.5e-3
    offset: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class Motion:
    """A noise-free run: t (k,) [s], nodes (k, n + 1, 3) [m]."""

    t: np.ndarray
    nodes: np.ndarray


def simulate_truth(
    scene: SceneLike, duration: float, rate: float = 60.0, substeps: int = 40, integrator: str = "energy_momentum"
) -> Motion:
    """A run of a scene, by default with another integrator and a 20 times finer step than a fit uses."""
    scene = load_scene(scene)
    model, start = build(scene)
    stepper = make_stepper(model, integrator, "auto", track_work=False)
    frames = round(duration * rate)
    trajectory = _run(stepper, model, start, 1 / (rate * substeps), frames * substeps, substeps)
    if int(trajectory.first_bad[-1]) >= 0:
        raise SceneError("synthetic: the run of the true model failed. Use a scene that runs, or a finer step")
    free = np.concatenate([np.asarray(start.r)[None], np.asarray(trajectory.r)])
    t = np.arange(frames + 1) / rate
    nodes = jax.vmap(lambda r, t: model.nodes(r, model.ends(t)))(free, t)
    return Motion(t, np.asarray(nodes))


@cached_jit(static=("stepper", "steps", "every"), kernel=True)
def _run(stepper: Stepper, model: Model, start: State, h: float, steps: int, every: int) -> Trajectory:
    dt = jnp.asarray(h, model.dtype)
    return advance(stepper, model, begin(stepper, model, start), dt, steps // every, every)[1]


def observe(motion: Motion, camera: Camera, seed: int, name: str = "synthetic") -> Trace:
    """Angles from the horizontal, as seen by the camera; the same seed gives the same noise."""
    rng = np.random.default_rng(seed)
    keep = motion.t >= camera.delay - 1e-12
    nodes = motion.nodes[keep][..., [0, 2]]
    seen = nodes + camera.pixel * camera.pixel_noise * rng.standard_normal(nodes.shape)
    link = np.diff(seen, axis=1)
    theta = np.unwrap(np.arctan2(-link[..., 1], link[..., 0]), axis=0) + camera.offset
    theta = theta + camera.angle_noise * rng.standard_normal(theta.shape)
    wrong = rng.random(theta.shape) < camera.outliers
    theta = np.where(wrong, theta + rng.uniform(-0.5, 0.5, theta.shape), theta)
    theta = np.where(rng.random(theta.shape) < camera.missing, np.nan, theta)
    return Trace(name, motion.t[keep] - camera.delay, theta, convention=Convention("horizontal", 1, "rad"))


def synthetic_traces(scenes: Sequence[SceneLike], duration: float, camera: Camera, progress: Progress) -> list[Trace]:
    """One trace per scene, such as scenarios A, B and C; labelled as synthetic by their names."""
    found = []
    for i, scene in enumerate(map(load_scene, scenes)):
        progress(i / len(scenes), f"synthetic trace of {scene.name}")
        motion = simulate_truth(scene, duration, camera.rate)
        found.append(observe(motion, camera, i, f"synthetic-{scene.name}"))
    return found
