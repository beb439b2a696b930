"""A station that has judged a few presses, and its bundle: for what is learnt from operation."""

from confirmed_station import inspected, other_package, station

__all__ = ["inspected", "other_package", "station"]
