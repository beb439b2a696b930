"""A station that has judged a few presses, and its bundle: for what is learnt from operation."""

from confirmed_station import inspected, inspected_folder, station
from tiny_fit import other_package

__all__ = ["inspected", "inspected_folder", "other_package", "station"]
