"""Rounds of a gateway that plays presses, each with one fault; then how many presses were made, delivered and counted.

    python tests/support/soak.py --rounds 60

Each round is a gateway process of its own on the same database, with a real broker and a subscriber. *Made* is a press
that the database has; *delivered*, one whose result the subscriber has; *counted*, one that the gel's count has. Every
message that the subscriber gets is checked against the AsyncAPI document that the station keeps at the broker. Faults
of the sensor and of the disk are those of the simulation (docs/simulation.md).
"""

import argparse
import json
import multiprocessing
import os
import random
import signal
import sqlite3
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion
from station import MQTT, Motion, press_recording, small_bundle, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Received
from edge.messaging.validation import StationsCheck
from edge.store.integrity import check_database
from edge.store.outbox import Outbox

PRESSES = 6  # of the recording that each round plays
# Far more than any round needs; only a gateway that hangs comes to this.
ROUND_S = 120.0
PROCESSES = multiprocessing.get_context("forkserver")


@dataclass
class Outcome:
    """What was done, and what became of the presses. doubled: results that came twice with another content. findings:
    faults of the database at the end. checked, undescribed: messages, and what is wrong with those that are not as the
    station's document says."""

    faults: Counter[str] = field(default_factory=Counter)
    made: int = 0
    delivered: int = 0
    counted: int = 0
    lost: int = 0
    doubled: int = 0
    findings: list[str] = field(default_factory=list)
    checked: int = 0
    undescribed: list[str] = field(default_factory=list)


class Subscriber:
    """Every result, by press id: the contents that it came with."""

    def __init__(self, port: int) -> None:
        self.results: dict[str, set[str]] = defaultdict(set)
        self.check = StationsCheck()
        self.faults: list[str] = []
        self._is_subscribed = threading.Event()
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe("gelgate/#", 1)
        self._client.on_subscribe = lambda *_: self._is_subscribed.set()
        self._client.on_disconnect = lambda *_: self._is_subscribed.clear()
        self._client.on_message = self._arrived
        self._client.reconnect_delay_set(0.05, 0.2)  # type: ignore[arg-type]  # paho takes fractions
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self.wait()

    def wait(self) -> None:
        """Until the broker sends everything from now on. Errors: TimeoutError."""
        if not self._is_subscribed.wait(ROUND_S):
            raise TimeoutError("the subscriber has no broker")

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _arrived(self, client: object, data: object, message: paho.MQTTMessage) -> None:
        received = Received(message.topic, bytes(message.payload), message.qos, message.retain)
        self.faults += self.check.see(_closed(received))
        if message.topic.endswith("/gel/v1/result"):
            content = json.loads(message.payload)
            content.pop("is_replayed")
            self.results[content["press_id"]].add(json.dumps(content, sort_keys=True))


def _closed(message: Received) -> Received:
    """The document with its schemas closed: a field that it does not name is a fault too."""
    if not message.topic.endswith("/asyncapi"):
        return message
    document = json.loads(message.payload)
    for schema in document["components"]["schemas"].values():
        if "properties" in schema:
            schema["additionalProperties"] = False
    return replace(message, payload=json.dumps(document).encode())


def until(is_so: Callable[[], object]) -> None:
    """Wait until that is so, or far longer than any round needs."""
    deadline = time.monotonic() + ROUND_S
    while not is_so() and time.monotonic() < deadline:
        time.sleep(0.01)


def play(config: Path, empties_outbox: bool) -> None:
    """A gateway process: play the recording to its end, or until SIGTERM."""
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    loaded = load_config(config)
    with open_station(loaded, SystemClock()) as gateway, Outbox(loaded.store.path) as outbox:
        gateway.run(stop)
        if empties_outbox:
            until(lambda: not outbox.status().rows)


class Bench:
    """The station, its broker and its subscriber, in one folder."""

    def __init__(self, folder: Path, broker: LocalBroker, rng: random.Random) -> None:
        self.broker = broker
        self.rng = rng
        self.folder = folder
        self.database = folder / "gelgate.db"
        nominal = press_recording(folder / "nominal", 12, seed=1)
        self._bundle = small_bundle(folder / "bundle", nominal)
        motion = Motion(free=36, hold=12, idle=6)
        self._recording = press_recording(folder / "presses", PRESSES, dented=[1], seed=2, motion=motion)
        self.subscriber = Subscriber(broker.port)

    def start(self, *, empties_outbox: bool = False) -> ForkServerProcess:
        """The next gateway."""
        config = station_config(self.folder, self._recording, self._bundle, sinks=MQTT % self.broker.port)
        process = PROCESSES.Process(target=play, args=(config, empties_outbox))
        process.start()
        return process

    def wait_for_press(self) -> None:
        """Until this round's gateway has recorded one more press."""
        before = self.presses()
        until(lambda: self.presses() != before)

    def some_time(self) -> None:
        """So that a fault comes at another moment each time."""
        time.sleep(self.rng.uniform(0, 0.1))

    def presses(self) -> int:
        with suppress(sqlite3.OperationalError), closing(sqlite3.connect(self.database)) as connection:
            return int(connection.execute("SELECT count(*) FROM presses").fetchone()[0])
        return 0  # the first gateway has not made it yet


def end_the_gateway(bench: Bench, end: Callable[[ForkServerProcess], None]) -> ForkServerProcess:
    process = bench.start()
    bench.wait_for_press()
    bench.some_time()
    end(process)
    return process


def restart_the_broker(bench: Bench) -> ForkServerProcess:
    """The gateway goes on without it; the subscriber is back before the next gateway sends."""
    process = bench.start()
    bench.wait_for_press()
    bench.broker.stop()
    end(process)
    bench.broker.start()
    bench.subscriber.wait()
    return process


def freeze_the_broker(bench: Bench) -> ForkServerProcess:
    process = bench.start()
    bench.some_time()
    pid = bench.broker.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        bench.wait_for_press()
        bench.some_time()
    finally:
        os.kill(pid, signal.SIGCONT)
    return process


FAULTS: dict[str, Callable[[Bench], ForkServerProcess]] = {
    "no fault": lambda bench: bench.start(),  # first: it makes the database
    "gateway killed": lambda bench: end_the_gateway(bench, ForkServerProcess.kill),
    "gateway stopped": lambda bench: end_the_gateway(bench, ForkServerProcess.terminate),
    "broker restarted": restart_the_broker,
    "broker frozen": freeze_the_broker,
}


def end(process: ForkServerProcess) -> None:
    """Errors: TimeoutError for a gateway that hangs."""
    process.join(ROUND_S)
    if process.is_alive():
        process.kill()
        process.join()
        raise TimeoutError(f"a gateway did not end within {ROUND_S:.0f} s")


def soak(folder: Path, rounds: int, seed: int = 0, say: Callable[[str], None] = lambda line: None) -> Outcome:
    """Rounds of every fault in turn, and one that empties the outbox."""
    outcome = Outcome()
    with LocalBroker() as broker:
        bench = Bench(folder, broker, random.Random(seed))
        try:
            for number in range(rounds):
                name = list(FAULTS)[number % len(FAULTS)]
                end(FAULTS[name](bench))
                outcome.faults[name] += name != "no fault"
                say(f"{number + 1}/{rounds}  {name}: {bench.presses()} presses made")
            end(bench.start(empties_outbox=True))
            until(lambda: len(bench.subscriber.results) >= bench.presses())
        finally:
            bench.subscriber.close()
        outcome.faults += Counter()  # without zeros
        _judge(bench, outcome)
    return outcome


def _judge(bench: Bench, outcome: Outcome) -> None:
    with closing(sqlite3.connect(bench.database)) as connection:
        made = {row[0] for row in connection.execute("SELECT press_id FROM presses")}
        outcome.counted = connection.execute("SELECT coalesce(sum(presses), 0) FROM gels").fetchone()[0]
    results = bench.subscriber.results
    outcome.made, outcome.delivered = len(made), len(made & set(results))
    outcome.lost = outcome.made - outcome.delivered
    outcome.doubled = sum(len(contents) > 1 for contents in results.values())
    outcome.checked, outcome.undescribed = bench.subscriber.check.checked, bench.subscriber.faults
    outcome.undescribed += [f"{root}: no document" for root in bench.subscriber.check.undescribed]
    outcome.findings = [finding.text for finding in check_database(bench.database) if finding.is_fault]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=60, help="one fault each, in turn")
    parser.add_argument("--seed", type=int, default=0, help="of the moments of the faults")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gelgate-soak-") as folder:
        outcome = soak(Path(folder), given.rounds, given.seed, lambda line: print(line, flush=True))
    print(outcome)
    faults = (outcome.lost, outcome.doubled, outcome.findings, outcome.undescribed)
    if any(faults) or outcome.counted != outcome.made:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
