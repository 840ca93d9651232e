"""What can break, as arrays."""

from __future__ import annotations

import jax

from dropper_jax.base.fields import component, option


@component
class Failures:
    """What can break, m entries: loads (m, n) [N], infinite where an entry does not watch; times (m,) [s] or infinite.

    `named` holds the index of the link that an entry names, -1 for the most loaded one.
    """

    load: jax.Array
    time: jax.Array
    named: tuple[int, ...] = option("links that entries name", default=())
