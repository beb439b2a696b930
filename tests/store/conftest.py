"""A store, and presses to record in it."""

from recorded_presses import make_press, messages_of, path, store

__all__ = ["make_press", "messages_of", "path", "store"]
