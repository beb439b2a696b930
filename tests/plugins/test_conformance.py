"""Every built-in plugin passes the published checks."""

import json
from collections.abc import Callable
from pathlib import Path

import benches
import pytest

from calibration.experiments.backbones.evaluation import default_detectors
from edge import registry
from edge.core.detector import HasReference
from plugins.conformance import (
    DETECTOR_CHECKS,
    DEVICE_CHECKS,
    OVERVIEW_CHECKS,
    SINK_CHECKS,
    DetectorCase,
    DeviceBench,
    OverviewBench,
    SinkBench,
)

ROOT = Path(__file__).resolve().parents[2]


def named(check: Callable[..., None]) -> str:
    return check.__name__


@pytest.mark.parametrize("check", DETECTOR_CHECKS, ids=named)
@pytest.mark.parametrize("method", registry.names("detectors"))
def test_a_built_in_detector_conforms(method: str, check: Callable[[DetectorCase], None]) -> None:
    """The check's own docstring states the fact."""
    check(DetectorCase(registry.detector(method)))


def test_the_built_in_detectors_say_what_lists_of_names_would() -> None:
    """The model card compares those that are no baseline; all have oracles."""
    detectors = {name: registry.detector(name) for name in registry.names("detectors")}
    compared = json.loads((ROOT / "plugins/backbones/tactile_resnet18_evaluation.json").read_text())[
        "settings"
    ]

    assert set(default_detectors()) == set(compared)
    assert all(isinstance(one, HasReference) for one in detectors.values())


@pytest.mark.parametrize("check", DEVICE_CHECKS, ids=named)
@pytest.mark.parametrize("make_bench", benches.DEVICES.values(), ids=benches.DEVICES)
def test_a_built_in_device_conforms(
    make_bench: benches.Make[DeviceBench], check: Callable[[DeviceBench], None]
) -> None:
    """The check's own docstring states the fact."""
    with make_bench() as bench:
        check(bench)


@pytest.mark.parametrize("check", OVERVIEW_CHECKS, ids=named)
@pytest.mark.parametrize("make_bench", benches.OVERVIEWS.values(), ids=list(benches.OVERVIEWS))
def test_a_built_in_overview_camera_conforms(
    make_bench: benches.Make[OverviewBench], check: Callable[[OverviewBench], None]
) -> None:
    """The check's own docstring states the fact."""
    with make_bench() as bench:
        check(bench)


# A blocked read ends with OpenCV's own timeout, which counts as a lost sensor.
WITHOUT_DEADLINES = ("check_the_deadline_is_kept", "check_after_the_last_frame")


@pytest.mark.parametrize(
    "check", [check for check in DEVICE_CHECKS if named(check) not in WITHOUT_DEADLINES], ids=named
)
def test_the_v4l2_reader_conforms_but_for_deadlines(check: Callable[[DeviceBench], None]) -> None:
    """The check's own docstring states the fact."""
    check(benches.V4l2Bench())


@pytest.mark.parametrize("check", SINK_CHECKS, ids=named)
@pytest.mark.parametrize("make_bench", benches.SINKS.values(), ids=benches.SINKS)
def test_a_built_in_sink_conforms(
    make_bench: benches.Make[SinkBench], check: Callable[[SinkBench], None]
) -> None:
    """The check's own docstring states the fact."""
    with make_bench() as bench:
        check(bench)


def test_every_built_in_device_overview_camera_and_sink_has_a_bench() -> None:
    """A new plugin cannot be forgotten here. The real sensor is read by the driver that usb_mock drives, or by V4L2; a
    Sparkplug node and the page make something else of messages, where the checks expect the same bytes."""
    assert {*registry.names("overviews")} == {*benches.OVERVIEWS}
    assert {*registry.names("devices")} == {*benches.DEVICES, "gelsight_mini"}
    assert {*registry.names("sinks")} == {
        *(name.partition(" ")[0] for name in benches.SINKS),
        "sparkplug",
        "page",
    }
