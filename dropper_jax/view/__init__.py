"""`dropper view`: a run as one interactive HTML page that works offline."""

from dropper_jax.view.make import pair_page, view_page, write_view

__all__ = ["pair_page", "view_page", "write_view"]
