"""Windows of storms in which a line breaks: the first third intact while the waves rise, then without its link.

    s_1 = run(intact, s_0),    s_2 = run(parted, s_1)

Derivatives are those of both runs, so the impact of the break is in them. The peak load of a whole run may occur long
after the break, when the farm has drifted to another position. The window then starts from the equilibrium without that
link (`Window.starts_broken`), which is solved again and follows the variables by its own stiffness.
"""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model
from fitting.farm.optimise.calm_model import CalmModel
from fitting.farm.site.states import Break


def link_of(model: Model, broken: Break) -> int:
    """Number of the link that breaks."""
    spans = zip(model.geometry.members, model.geometry.spans, strict=True)
    own = next(span for member, span in spans if member.name == broken.line)
    return int(np.arange(model.line.links)[own][broken.link - 1])


def with_link_mask(model: Model, broken_link: int | None) -> Model:
    """The model with a mask of intact links, without `broken_link`; with None all are intact."""
    intact = jnp.ones(model.line.links, model.dtype)
    if broken_link is not None:
        intact = intact.at[broken_link].set(0.0)
    return model.with_axial(model.line.axial.with_broken_links(intact))


def mask_link(found: CalmModel, broken_link: int | None) -> CalmModel:
    """The same for a model, including the derivatives of its leaves with respect to the variables."""
    return replace(found, model=with_link_mask(found.model, broken_link))
