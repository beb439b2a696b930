"""A gateway that is killed between any two writes of a press, and started again."""

import json
import multiprocessing
import shutil
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import killed_gateway
import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from station import MQTT, Motion, press_recording, station_config

from edge.messaging.local_broker import LocalBroker
from edge.store.press_store import Store


@pytest.fixture(scope="module")
def broker() -> Iterator[LocalBroker]:
    with LocalBroker() as running:
        yield running


@pytest.fixture(scope="module")
def one_press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return press_recording(
        tmp_path_factory.mktemp("one") / "presses", 1, motion=Motion(free=36, hold=14, idle=3)
    )


class Results:
    """Every result that a subscriber sees, by station: press id to the contents it came with."""

    def __init__(self, port: int) -> None:
        self.seen: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        is_subscribed = threading.Event()
        self._client.on_connect = lambda client, *_: client.subscribe("gelgate/site/#", 1)
        self._client.on_subscribe = lambda *_: is_subscribed.set()
        self._client.on_message = self._arrived
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert is_subscribed.wait(60)

    def _arrived(self, client: object, data: object, message: paho.MQTTMessage) -> None:
        _, _, _, station, *rest = message.topic.split("/")
        if rest[-1] == "result":
            content = json.loads(message.payload)
            content.pop("is_replayed")
            self.seen[station][content["press_id"]].add(json.dumps(content, sort_keys=True))

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


# Every process is forked from one that has done the imports: they cost more than a press.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["edge.gateway.gateway"])
# What multiprocessing gives where the fork server's report of a process did not arrive, as happened once.
# A process that failed reports 1, and one that lived has left its count of writes.
STATUS_LOST = 255


def run(config: Path, deadly: int) -> int | None:
    """One process's life; its exit code."""
    at_its_end = config.parent / "writes"
    at_its_end.unlink(missing_ok=True)
    process = PROCESSES.Process(target=killed_gateway.main, args=(config, deadly))
    process.start()
    process.join(300)
    if process.exitcode == STATUS_LOST:
        return 0 if at_its_end.exists() else killed_gateway.KILLED
    return process.exitcode


def killed_again_and_again(config: Path, deadly: Sequence[int]) -> tuple[int, list[int]]:
    """One station, killed at each of these writes in turn, then left to finish: kills, and presses on record then.

    A run that lives has made fewer writes than the one that they were counted in: the publisher looks for refused rows
    once a connection and again after some time, which is before the press or after it.
    """
    recorded, ends = [], []
    for write in (*deadly, 0):
        ends.append(run(config, write))
        assert ends[-1] in (killed_gateway.KILLED, 0), write
        recorded.append(len(press_rows(config.parent)[0]))
    assert ends[-1] == 0
    return ends.count(killed_gateway.KILLED), recorded


def test_each_press_arrives_exactly_once_by_id_and_the_ledger_agrees(
    tmp_path: Path, bundle: Path, one_press: Path, broker: LocalBroker
) -> None:
    """For every last write, no press is lost, doubled or counted twice."""

    def config(station: str) -> Path:
        # A recording is one sensor, which one process holds at a time.
        recording = shutil.copytree(one_press, tmp_path / "recordings" / station)
        path = station_config(tmp_path / station, recording, bundle, pace=0, sinks=MQTT % broker.port)
        path.write_text(path.read_text() + f'[station]\nstation = "{station}"\n')
        return path

    results = Results(broker.port)
    whole = config("whole")
    assert run(whole, 0) == 0
    # The last writes are the publisher's acknowledgements: a killed process may have left fewer of them to do.
    writes = range(1, int((whole.parent / "writes").read_text()) - 1)
    assert len(writes) >= 10
    # Most of a run is waiting for the press, so four stations share the writes.
    with ThreadPoolExecutor(4) as pool:
        chains = {
            name: pool.submit(killed_again_and_again, config(name), writes[start::4])
            for start, name in enumerate(("one", "two", "three", "four"))
        }
    stations = {name: press_rows(tmp_path / name) for name in chains}
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and any(
        set(results.seen[s]) != ids for s, (ids, _) in stations.items()
    ):
        time.sleep(0.05)
    results.close()

    for station, (ids, count) in stations.items():
        assert set(results.seen[station]) == ids, station
        assert count == len(ids), station
        assert all(len(contents) == 1 for contents in results.seen[station].values()), station
    grown = {
        later - earlier for chain in chains.values() for earlier, later in pairwise([0, *chain.result()[1]])
    }
    assert sum(chain.result()[0] for chain in chains.values()) >= len(writes) - 4
    assert grown == {0, 1}  # killed before its press was recorded, and after


def press_rows(folder: Path) -> tuple[set[str], int]:
    """The ids of the recorded presses, and the ledger's count."""
    with Store(folder / "gelgate.db") as store:
        return {press.press_id for press, _ in store.presses()}, sum(gel.presses for gel in store.gels())
