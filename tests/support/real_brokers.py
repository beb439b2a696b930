"""Real brokers; where one is missing the test is skipped, and says so."""

from collections.abc import Iterator

import pytest

from edge.messaging.local_broker import LocalBroker, available_brokers

__all__ = ["mosquitto", "require"]


def require(kind: str) -> None:
    if kind not in available_brokers():
        pytest.skip(f"SKIPPED, NOT TESTED: the broker {kind} is not installed")


@pytest.fixture
def mosquitto() -> Iterator[LocalBroker]:
    require("mosquitto")
    with LocalBroker("mosquitto") as broker:
        yield broker
