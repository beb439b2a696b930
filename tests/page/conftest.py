"""The sink `page` at a free port, without a station behind it, and a station of recorded presses."""

from collections.abc import Iterator

import pytest
from page_messages import ROOT
from real_brokers import mosquitto
from station import bundle, recording

from edge.clock import ManualClock
from edge.core.sink_context import Station
from plugins.sinks.page import PageOptions, PageSink

__all__ = ["bundle", "mosquitto", "recording"]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def sink(clock: ManualClock) -> Iterator[PageSink]:
    """It only shows."""
    opened = PageSink(PageOptions(), Station(ROOT, "press2"), clock, port=0)
    yield opened
    opened.close()
