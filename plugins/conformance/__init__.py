"""Checks that every plugin passes: built-in plugins in the tests of gelgate, others in the tests of their authors.

Each check is a function whose docstring states a fact. `check_detector`, `check_device`, `check_feature`,
`check_overview`, `check_sink`, `check_trigger`, `check_actuator` and `check_handshake` run all checks of a kind and
raise one exception group with every fact that is not true. Faults are included: a pulled cable, an absent receiver, a
refused message, features that are not finite, no presses, a second closing.

Prior art: the check functions of trio.testing.
"""

from plugins.conformance.actuator import ACTUATOR_CHECKS, ActuatorBench, check_actuator
from plugins.conformance.detector import DETECTOR_CHECKS, DetectorCase, check_detector
from plugins.conformance.device import DEVICE_CHECKS, DeviceBench, check_device
from plugins.conformance.feature import FEATURE_CHECKS, FeatureCase, check_feature
from plugins.conformance.handshake import HANDSHAKE_CHECKS, HandshakeBench, check_handshake
from plugins.conformance.overview import OVERVIEW_CHECKS, OverviewBench, check_overview
from plugins.conformance.played_station import PlayedStation, open_played
from plugins.conformance.sink import SINK_CHECKS, SinkBench, check_sink
from plugins.conformance.trigger import TRIGGER_CHECKS, TriggerBench, check_trigger

__all__ = [
    "ACTUATOR_CHECKS",
    "DETECTOR_CHECKS",
    "DEVICE_CHECKS",
    "FEATURE_CHECKS",
    "HANDSHAKE_CHECKS",
    "OVERVIEW_CHECKS",
    "SINK_CHECKS",
    "TRIGGER_CHECKS",
    "ActuatorBench",
    "DetectorCase",
    "DeviceBench",
    "FeatureCase",
    "HandshakeBench",
    "OverviewBench",
    "PlayedStation",
    "SinkBench",
    "TriggerBench",
    "check_actuator",
    "check_detector",
    "check_device",
    "check_feature",
    "check_handshake",
    "check_overview",
    "check_sink",
    "check_trigger",
    "open_played",
]
