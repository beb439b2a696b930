"""A store, and presses to record in it."""

from recorded_presses import path, store

__all__ = ["path", "store"]
