"""The sink `page` at a free port, without a station behind it, and a station of recorded presses."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from page_messages import ROOT
from station import press_recording, small_bundle

from edge.clock import ManualClock
from edge.core.sink_context import Station
from plugins.sinks.page import PageOptions, PageSink


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def sink(clock: ManualClock) -> Iterator[PageSink]:
    """It only shows."""
    opened = PageSink(PageOptions(), Station(ROOT, "press2"), clock, port=0)
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle fitted on twelve nominal presses."""
    folder = tmp_path_factory.mktemp("bundle")
    return small_bundle(folder / "pz0", press_recording(folder / "nominal", 12, seed=1))


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three presses, the second one dented."""
    return press_recording(tmp_path_factory.mktemp("recording") / "presses", 3, dented=[1], seed=2)
