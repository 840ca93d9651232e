"""`dropper view`: a run as one interactive HTML page that needs no network."""

from dropper_jax.view.make import view_page, write_view

__all__ = ["view_page", "write_view"]
