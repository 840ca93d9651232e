"""Settings of a fit: how traces are read and cut into windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dropper_jax.base.errors import require_positive
from fitting.traces.trace import Convention, convention
from fitting.windows.spans import Interval


@dataclass(frozen=True)
class FitSettings:
    """How a fit reads traces and cuts them into windows.

    Attributes:
        window: maximum length of a window [s]; None: as far as small errors in the motion may grow.
        dt: time step [s], at most the samples' interval; a shorter step that divides the interval is used. Default:
            1/75 of the shortest link's period, or 1/200 for second order.
        integrator: of the windows; default rattle_4 for point masses, otherwise energy_momentum. tsit5 and dop853 are
            faster for lines that they support; their steps then end at multiples of `dt`.
        rest: (low, high) [s] in which the line hangs at rest, before it moves or after it has stopped; these poses are
            fitted together with the motion.
        static_start: every run starts from the scene's `[start]` and is released at t = 0 of its clock; free names such
            as `release.time` and `release.force` imply it.
        zero, sign, unit: angle convention of the traces; default from the files, otherwise inferred from the scene.
        columns: the files' columns if they have other names: `{"time": "timestamp", "theta_1": "angle"}`.
        begin: samples before this time [s] are not fitted.
        fixed: whether the scene's lengths and the zero of the angles are kept where neither the caller nor the scene's
            `[fit]` lists what is free; otherwise a scale of the lengths and the zero are free too.
        same_motion: whether the traces are recordings of one motion (`parameters.recordings`), not runs. All but the
            first one have zeros, a scale and a delay, free unless the caller frees some of them by name.
    """

    window: float | None = None
    dt: float | None = None
    integrator: str | None = None
    rest: Sequence[Interval] = ()
    static_start: bool = False
    zero: str | None = None
    sign: str | int | None = None
    unit: str | None = None
    columns: Mapping[str, str] | None = None
    begin: float | None = None
    fixed: bool = False
    same_motion: bool = False

    def __post_init__(self) -> None:
        for option, length in (("window", self.window), ("dt", self.dt)):
            if length is not None:
                require_positive(option, length, " s")

    @property
    def convention(self) -> Convention:
        """The given convention of the angles, checked."""
        return convention(self.zero, self.sign, self.unit)


#: No settings: everything from the traces and the scene.
AUTOMATIC = FitSettings()
