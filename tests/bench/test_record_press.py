"""What the messages of a press cost in bytes, in the outbox and at a broker."""

import time
from collections import Counter
from pathlib import Path

import pytest
from station import MQTT, station_config
from stepped_station import SteppedStation

from calibration import demo
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.messaging.subscriber import listening, next_message
from edge.store.outbox import ROW_OVERHEAD_BYTES, Outbox


@pytest.fixture(scope="module")
def bolts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The bundle and the test recording of `gelgate demo`."""
    folder = tmp_path_factory.mktemp("bolts")
    nominal, test = demo._simulate(folder, seed=0)
    demo._fit(nominal, folder / "bundle")
    return folder / "bundle", test


FORMS = {
    "by default": "",
    "last_heatmap = true, or for Home Assistant": "last_heatmap = true",
    'heatmap = "png", last_heatmap = true': 'heatmap = "png"\nlast_heatmap = true',
}


@pytest.mark.bench
@pytest.mark.parametrize("form", FORMS)
def test_the_bytes_of_a_press(bolts: tuple[Path, Path], tmp_path: Path, form: str) -> None:
    """Prints what a scored press adds to the outbox, by topic, and what a broker receives for it."""
    bundle, recording = bolts
    sizes, rows = Counter[str](), 0
    with LocalBroker("mosquitto", extra="sys_interval 1") as broker:
        tables = f"[station]\nstats_s = 60\n{FORMS[form]}"
        config = station_config(tmp_path, recording, bundle, sinks=MQTT % broker.port, tables=tables)
        with SteppedStation(config) as station, Outbox(tmp_path / "gelgate.db") as outbox:
            station.publish()
            before = received_bytes(broker)
            while not station.has_ended:
                station.read(1)
                station.look()
                for row in outbox.pending(next(iter(station.parts.publisher.workers)), 100):
                    rows += 1
                    sizes[row.message.topic.partition("/0")[0]] += len(row.message.payload)
                station.publish()
            sent = received_bytes(broker) - before
            presses = sum(result.heatmap_topic is not None for result in station.results)
            assert (outbox.status().rows, presses) == (0, len(station.results))
    kept = sum(sizes.values()) + rows * ROW_OVERHEAD_BYTES
    print(
        f"\n{form}: {presses} presses; in the outbox {kept / presses / 1e3:.1f} kB a press, "
        f"sent {sent / presses / 1e3:.1f} kB"
    )
    for topic, size in sizes.most_common():
        print(f"  {topic}: {size / presses / 1e3:.2f} kB")


def received_bytes(broker: LocalBroker) -> int:
    """All that mosquitto has received since its start, as it says every second."""
    time.sleep(2.5)
    reader = Broker(broker.host, broker.port, "reader", level="5", timeout_s=60.0)
    with listening(reader, "$SYS/broker/bytes/received") as (_, inbox):
        message = next_message(inbox, 60)
    assert message is not None
    return int(message.payload)
