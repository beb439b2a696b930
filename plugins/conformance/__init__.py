"""Checks that every plugin passes: built-in plugins in the tests of gelgate, others in the tests of their authors.

Each check is a function whose docstring states a fact. `check_detector`, `check_device`, `check_overview` and
`check_sink` run all checks of a kind and raise one exception group with every fact that is not true. Faults are
included: a pulled cable, an absent receiver, a refused message, features that are not finite, no presses, a second
closing.

Prior art: the check functions of trio.testing.
"""

from plugins.conformance.detector import DETECTOR_CHECKS, DetectorCase, check_detector
from plugins.conformance.device import DEVICE_CHECKS, DeviceBench, check_device
from plugins.conformance.overview import OVERVIEW_CHECKS, OverviewBench, check_overview
from plugins.conformance.sink import SINK_CHECKS, SinkBench, check_sink

__all__ = [
    "DETECTOR_CHECKS",
    "DEVICE_CHECKS",
    "OVERVIEW_CHECKS",
    "SINK_CHECKS",
    "DetectorCase",
    "DeviceBench",
    "OverviewBench",
    "SinkBench",
    "check_detector",
    "check_device",
    "check_overview",
    "check_sink",
]
