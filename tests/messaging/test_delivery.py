"""From the store to a subscriber, with a broker that is killed in the middle."""

import json
import random
import signal
from collections import Counter
from pathlib import Path

from recorded_presses import T0, make_press, messages_of
from waiting import wait_until

from edge.clock import SystemClock
from edge.core.backoff import Backoff
from edge.gateway.commands import Change, CommandPolicy, Commands
from edge.messaging.local_broker import LocalBroker
from edge.messaging.publisher import Publisher
from edge.messaging.sink_worker import IDLE_S, RetainedState, SinkWorker
from edge.messaging.status_payloads import StatePayload
from edge.store.outbox import Outbox
from edge.store.press_store import Store

from .conftest import ROOT, Listen, Listener, SinkTo, seldom_amqtt


def record_press(store: Store, n: int) -> str:
    """Record the n-th press as the gateway does; return its id."""
    press = make_press(n)
    store.record_press(press, messages_of(press, 30_000))
    return press.press_id


@seldom_amqtt
def test_a_broker_killed_in_the_middle_and_restarted_loses_nothing(
    any_broker: tuple[LocalBroker, str], tmp_path: Path, sink_to: SinkTo, listen: Listen
) -> None:
    """Each press arrives at least once and, counted by id, exactly once; its heatmap too; `last` is the newest. The
    worker is stepped by hand, so that the subscriber is always back before the gateway sends."""
    broker, protocol = any_broker
    path = tmp_path / "gelgate.db"
    sink = sink_to(broker, protocol=protocol)
    ids: list[str] = []
    heard: list[Listener] = []
    with Store(path) as store, Outbox(path) as outbox:
        outbox.register(["mqtt"])
        backoff = Backoff(random.Random(1), 0.05, 0.2)
        worker = SinkWorker("mqtt", sink, outbox, RetainedState(), SystemClock(), backoff)
        for outage in range(2):
            heard.append(listen(broker, client_id=f"listener{outage}"))
            wait_until(lambda: worker.step() == IDLE_S)
            ids += [record_press(store, len(ids)) for _ in range(10)]
            worker.step()  # one batch: some presses are out, some are not
            hears_all_acknowledged(heard, ids, outbox)
            broker.stop(signal.SIGKILL)
            ids += [record_press(store, len(ids)) for _ in range(5)]
            assert worker.step() > 0
            broker.start()
        heard.append(listen(broker, client_id="last"))
        wait_until(lambda: worker.step() == IDLE_S)
        hears_all_acknowledged(heard, ids, outbox)

        assert outbox.status().rows == 0
    times = Counter(press_id for listener in heard for press_id in results(listener))
    assert set(times) == set(ids)
    assert max(times.values()) <= 2
    heard[-1].wait_for(lambda listener: newest(listener) == ids[-1])


def newest(listener: Listener) -> str | None:
    payloads = listener.payloads("last")
    return json.loads(payloads[-1])["press_id"] if payloads else None


def results(listener: Listener) -> list[str]:
    return [json.loads(payload)["press_id"] for payload in listener.payloads("result")]


def hears_all_acknowledged(heard: list[Listener], ids: list[str], outbox: Outbox) -> None:
    """Wait until every row that the broker acknowledged has arrived: a killed broker loses its messages."""
    waiting = [row.message for row in outbox.pending("mqtt", 1000)]
    acknowledged = set(ids) - {json.loads(m.payload)["press_id"] for m in waiting if m.topic == "result"}
    pictures = {f"heatmap/{press_id}" for press_id in ids} - {m.topic for m in waiting}

    def hears(last: Listener) -> bool:
        got = {press_id for listener in heard for press_id in results(listener)}
        seen = {m.topic.removeprefix(f"{ROOT}/") for listener in heard for m in listener.heard}
        return acknowledged <= got and pictures <= seen

    heard[-1].wait_for(hears)


def test_a_state_change_and_a_command_pass_while_results_flow(
    mosquitto: LocalBroker, tmp_path: Path, sink_to: SinkTo, listen: Listen
) -> None:
    """The gateway's composition in small: retained state, outbox, commands on one connection."""
    listener = listen(mosquitto)
    with Store(tmp_path / "gelgate.db") as store:
        handlers = {"ping": lambda arguments: Change({"echo": arguments["text"]})}
        commands = Commands(handlers, CommandPolicy(ROOT, frozenset(handlers)), store, SystemClock())
        sink = sink_to(mosquitto, commands)
        publisher = Publisher(store.path, {"mqtt": sink}, RetainedState(), SystemClock(), random.Random(1))
        publisher.start()
        publisher.announce(StatePayload(time_ns=T0, state="halted", reason="no sensor").message())
        listener.wait_for(lambda heard: len(heard.payloads("state")) == 2)
        record_press(store, 1)
        publisher.wake()
        listener.wait_for(lambda heard: heard.payloads("gel") != [])
        listener.ask("ping", b'{"transaction": "t1", "arguments": {"text": "hello"}}')
        listener.wait_for(lambda heard: heard.payloads("cmd/ping/response") != [])
        publisher.stop()

    (response,) = [json.loads(p) for p in listener.payloads("cmd/ping/response")]
    assert (response["transaction"], response["status"], response["data"]) == ("t1", "ok", {"echo": "hello"})
    assert json.loads(listener.payloads("state")[-1])["reason"] == "no sensor"
    assert listener.payloads("result") != []
