"""Fitting simulated droppers to measured traces; it builds on `dropper_jax`, never the other way round.

Folders, each importing only those before it: `traces`, `parameters`, `sweep` and `sensitivity` (need parameters
alone), `estimate`, `windows`, `laws`, `calibration` and `channels`, `report`, `from_file`, `cli`. Only the command
line imports `films` (which needs traces alone) and `farm`, with `site`, and `cases`, `season` and `optimise` of sites
(none needs another).
"""

from importlib import import_module
from typing import Any

import dropper_jax  # noqa: F401 - turns on float64 before anything is traced

#: Where each public name lives. They load on demand: `dropper --help` needs none of them.
PUBLIC = {
    "Camera": "traces.synthetic",
    "ChannelFit": "channels.result",
    "Convention": "traces.trace",
    "FitResult": "calibration.result",
    "FitSettings": "windows.fit_settings",
    "GradientDescent": "estimate.descent",
    "Huber": "estimate.loss",
    "Method": "windows.method",
    "Motion": "traces.synthetic",
    "SceneFit": "estimate.scene_fit",
    "StudentT": "estimate.loss",
    "Trace": "traces.trace",
    "TraceLoss": "calibration.trace_loss",
    "View": "films.render",
    "advise": "calibration.advice",
    "bootstrap": "estimate.bootstrap",
    "close_chain": "traces.planar",
    "compare": "calibration.comparison",
    "film": "films.render",
    "fit": "calibration.fit",
    "fit_and_free": "calibration.fit",
    "fit_channels": "channels.fit",
    "fitted_scene": "parameters.fitted_scene",
    "loss_of_trace": "calibration.trace_loss",
    "observe": "traces.synthetic",
    "predict": "calibration.prediction",
    "prepare": "windows.preparation",
    "profile": "estimate.profiles",
    "read_data": "channels.reading",
    "read_trace": "traces.trace_file",
    "simulate_truth": "traces.synthetic",
    "to_state": "traces.planar",
    "wrap": "traces.planar",
    "write_trace": "traces.trace_file",
    "write_video": "films.video",
}

__all__ = list(PUBLIC)


def __getattr__(name: str) -> Any:
    if name not in PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{PUBLIC[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *PUBLIC})
