"""The simulated station into whose presses damage is rendered."""

from pressed_dome import as_files_are_rendered, bench, station

__all__ = ["as_files_are_rendered", "bench", "station"]
