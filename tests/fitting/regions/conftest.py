"""A station that has judged a few presses, and its bundle."""

from confirmed_station import inspected, other_package, station

__all__ = ["inspected", "other_package", "station"]
