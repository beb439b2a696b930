"""Checks that every plugin passes: the built-in ones in this product's tests, others in their authors' tests.

Each check is a function whose docstring states a fact; `check_detector`, `check_device` and `check_sink` run all of
a kind and raise one exception group with every fact that does not hold. The unpleasant cases are among them: the cable
pulled, the receiver away, a message refused, features that are not finite, no presses, closing twice.

Prior art: the check functions of trio.testing.
"""

from plugins.conformance.detector import DETECTOR_CHECKS, DetectorCase, check_detector
from plugins.conformance.device import DEVICE_CHECKS, DeviceBench, check_device
from plugins.conformance.sink import SINK_CHECKS, SinkBench, check_sink

__all__ = [
    "DETECTOR_CHECKS",
    "DEVICE_CHECKS",
    "SINK_CHECKS",
    "DetectorCase",
    "DeviceBench",
    "SinkBench",
    "check_detector",
    "check_device",
    "check_sink",
]
