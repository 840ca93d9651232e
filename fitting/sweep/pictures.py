"""Pictures of a sweep: each kept quantity over one varied input, or over two as a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.plots import style
from fitting.sweep.plan import QUANTITIES
from fitting.sweep.run import open_sweep


@style.look()
def draw_sweep(path: str | Path, folder: str | Path) -> list[Path]:
    """A picture `QUANTITY.png` for each quantity of a sweep with one value per case.

    Over one input a line; over two a map; of more inputs the mean over all but the first two.

    Raises:
        SceneError: the sweep kept no quantity that has one value per case.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with open_sweep(path) as found:
        for name in (name for name in QUANTITIES if name in found):
            values = found[name].max("link") if "link" in found[name].dims else found[name]
            extra = values.dims[2:]
            mean = values.mean(extra) if extra else values
            label = f"{QUANTITIES[name][1]} [{QUANTITIES[name][0]}]"
            figure = style.new_figure(7.0, 4.4)
            axes = figure.subplots()
            if mean.ndim == 1:
                axes.plot(mean[mean.dims[0]], mean, "o-", color=style.FIRST, ms=3.5)
                axes.set(xlabel=_words(mean.dims[0]), ylabel=label)
            else:
                x, y = (np.asarray(mean[d]) for d in mean.dims)
                mesh = axes.pcolormesh(x, y, np.asarray(mean).T, cmap=style.tension_map(), shading="nearest")
                figure.colorbar(mesh, ax=axes, label=label)
                axes.set(xlabel=_words(mean.dims[0]), ylabel=_words(mean.dims[1]))
                axes.grid(False)
            if extra:
                axes.set_title(f"mean over {', '.join(map(_words, extra))}", loc="left")
            files.append(style.save(figure, folder / f"{name}.png"))
    if not files:
        raise SceneError(f"{path}: keeps no quantity to draw; allowed: a sweep of {', '.join(QUANTITIES)}")
    return files


def _words(name: object) -> str:
    return str(name).removeprefix("effects.")
