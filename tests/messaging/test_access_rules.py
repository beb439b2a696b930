"""The printed rules at a real mosquitto: a station stays in its topics, a reader changes nothing."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from edge.core.errors import SinkRejected
from edge.core.ports import Message
from edge.messaging.descriptions.access_rules import access_rules
from edge.messaging.descriptions.dashboards import discovery_topic
from edge.messaging.descriptions.station import DescribedStation, SparkplugNode
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.messaging.topics import TOPICS

from .conftest import PATIENCE_S, ROOT, require

STATION = DescribedStation.of_root(ROOT)
NODE = SparkplugNode.of(ROOT)
SHIPPED = Path(__file__).parents[2] / "deploy" / "mosquitto" / "rules.acl"
SENT = [topic.name for topic in TOPICS if topic.name != "cmd/<verb>"]


def filled(topic: str) -> str:
    return topic.replace("<press id>", "01ARZ3").replace("<alarm>", "disk").replace("<verb>", "trigger")


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalBroker]:
    """With rules by name; names need no password here."""
    require("mosquitto")
    rules = tmp_path_factory.mktemp("rules") / "rules.acl"
    rules.write_text(
        access_rules(STATION, "press2", discovery_prefix="homeassistant", node=NODE), encoding="utf-8"
    )
    # Started by root it reads the file as root; started by another user it ignores the name.
    with LocalBroker("mosquitto", extra=f"user root\nacl_file {rules}") as running:
        yield running


@pytest.fixture
def client(broker: LocalBroker) -> Iterator[Callable[..., Connection]]:
    """Connects by name at level 5, where the broker says what it denies."""
    opened: list[Connection] = []

    def make(name: str | None, on_received: Callable[[Received], None] | None = None) -> Connection:
        address = Broker(
            broker.host, broker.port, f"client-{name}", username=name, level="5", timeout_s=PATIENCE_S
        )
        opened.append(Connection.open(address, on_received=on_received))
        return opened[-1]

    yield make
    for connection in opened:
        connection.close()


def test_a_station_may_say_all_that_it_has_to_say(client: Callable[..., Connection]) -> None:
    """Every topic of the manual, the announcement to Home Assistant, and those of its Sparkplug node."""
    station = client("press2")

    for topic in SENT:
        station.publish(Message(f"{ROOT}/{filled(topic)}", b"{}"))
    station.publish(Message(discovery_topic(STATION, "homeassistant"), b"{}"))
    for verb in ("NBIRTH", "NDATA", "NDEATH"):
        station.publish(Message(f"spBv1.0/plant/{verb}/line1-press2", b"{}"))


FOREIGN = (
    f"{ROOT.replace('press2', 'press3')}/result",
    f"{ROOT}/weather",
    f"{ROOT}/cmd/trigger",
    f"{ROOT}/alarm/gel/more",
    "homeassistant/device/other/config",
    "homeassistant/status",
    "spBv1.0/plant/NBIRTH/line1-press3",
    "spBv1.0/plant/NCMD/line1-press2",
    "spBv1.0/STATE/host",
    "other",
)
OWN = [f"{ROOT}/{filled(topic)}" for topic in [*SENT, "cmd/<verb>"]]


@pytest.mark.parametrize(
    ("name", "topics"), [("press2", FOREIGN), ("reader", OWN), ("stranger", OWN), (None, OWN)]
)
def test_only_the_station_publishes_and_only_on_its_topics(
    client: Callable[..., Connection], name: str | None, topics: Sequence[str]
) -> None:
    """It leaves them for no other station or device, and asks itself nothing; a reader changes nothing."""
    connection = client(name)
    for topic in topics:
        with pytest.raises(SinkRejected, match="Not authorized"):
            connection.publish(Message(topic, b"{}"))


@pytest.mark.parametrize(("name", "hears"), [("reader", {"result"}), ("stranger", set())])
def test_a_reader_hears_what_the_station_says_and_no_request(
    client: Callable[..., Connection], name: str, hears: set[str]
) -> None:
    """A request may carry a signature; an unknown name hears nothing at all."""
    heard: list[Received] = []
    listener = client(name, heard.append)
    listener.subscribe(f"{ROOT}/result")
    listener.subscribe(f"{ROOT}/#")
    station = client("press2")

    station.publish(Message(f"{ROOT}/result", b"{}"))
    station.publish(Message(f"{ROOT}/cmd/x/response", b"{}"))
    listener.subscribe(f"{ROOT}/state")  # its acknowledgement comes after what was sent before

    assert {message.topic.removeprefix(f"{ROOT}/") for message in heard} == hears


def test_the_shipped_rules_are_the_printed_ones() -> None:
    """Those of the station of `deploy/`, line for line."""
    station = DescribedStation.of_root("gelgate/plant/line1/station1/gel/v1")
    block = access_rules(station, "station1").partition("user station1\n")[2].partition("\n\n")[0]

    shipped = SHIPPED.read_text(encoding="utf-8").partition("user station1\n")[2].partition("\n\n")[0]

    assert shipped.splitlines() == block.splitlines()
