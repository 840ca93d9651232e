"""What of a model takes part in its statics."""

from __future__ import annotations

from dataclasses import replace

from dropper_jax.model import Law, Model


def rest(model: Model) -> Model:
    """The model without laws of their own and without waves.

    Dry friction may hold many poses, the frictionless one is taken; waves pass, a current stays.
    """
    effects = tuple(e for e in model.effects if not isinstance(e, Law))
    return replace(model, effects=effects, sea=None if model.sea is None else model.sea.calm())
