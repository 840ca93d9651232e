"""Windows of storms in which a line breaks: the first third intact while the waves rise, then with its link gone.

    s_1 = run(intact, s_0),    s_2 = run(parted, s_1)

The way back goes through both, so the blow of the break is in the derivatives. A whole run may have its largest load
long after the break, when the farm has drifted to another place: then a window begins from the pose at rest without
that link (`settled`), which is sought anew and follows the variables by its own stiffness.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model
from fitting.optimise.models import Still
from fitting.site.case import Break


def link_of(model: Model, broken: Break) -> int:
    """Number of the link that parts."""
    spans = zip(model.geometry.members, model.geometry.spans, strict=True)
    own = next(span for member, span in spans if member.name == broken.line)
    return int(np.arange(model.line.links)[own][broken.link - 1])


def with_link_mask(model: Model, broken_link: int | None) -> Model:
    """The model with a mask of links that carry, without `broken_link`; with None all do."""
    intact = jnp.ones(model.line.links, model.dtype)
    intact = intact if broken_link is None else intact.at[broken_link].set(0.0)
    return replace(model, lines=(replace(model.line, axial=model.line.axial.with_broken_links(intact)),))


def masked_still(found: Still, broken_link: int | None) -> Still:
    """The same of a model with what its leaves owe to the variables."""
    model = with_link_mask(found.model, broken_link)
    path = jax.tree_util.tree_flatten_with_path
    number = {jax.tree_util.keystr(key): i for i, (key, _) in enumerate(path(model)[0])}
    names = [jax.tree_util.keystr(key) for key, _ in path(found.model)[0]]
    return Still(model, {number[names[i]]: slope for i, slope in found.slopes.items()}, found.assumed)
