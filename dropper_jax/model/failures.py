"""Link failures as arrays."""

from __future__ import annotations

import jax

from dropper_jax.base.fields import component, option


@component
class Failures:
    """Failures, m entries: loads (m, n) [N], infinite for links that an entry does not watch; times (m,) [s] or
    infinite.

    `named` holds the index of the link that an entry specifies, -1 for the most loaded one.
    """

    load: jax.Array
    time: jax.Array
    named: tuple[int, ...] = option("links specified by the entries", default=())
