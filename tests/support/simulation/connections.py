"""The connections between a station's MQTT sinks and the brokers of the run: pairs of sockets, and no thread.

The library's client is real but for three things: its socket ends at a simulated broker, its time is that of the run,
and where its own thread would run, the turn of the caller waits while others take theirs.
"""

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import paho.mqtt.client as paho
from greenlet import GreenletExit, getcurrent, greenlet

from edge.core.sink_context import Station
from plugins.sinks.mqtt import Mqtt, MqttSink
from plugins.sinks.mqtt_options import MqttOptions
from simulation.packets import CONNACK

if TYPE_CHECKING:
    from simulation.brokers import Broker
    from simulation.surroundings import SimulatedClock

S = 10**9
ANSWERED_S, CONNECTED_S = 10.0, 2.0
"""How long the sink waits for an acknowledgement, and for one of a CONNECT (docs/mqtt.md)."""
DRAINED_S = 2.0
AT_ONCE_S = 1e-5
"""What the sink takes instead: the run has waited already when the program begins to."""


class Turns:
    """A thread of the station that may wait in the middle of its turn. turn: returns the seconds until the next one."""

    def __init__(self, turn: Callable[[], float]) -> None:
        self._turn, self._current = turn, greenlet(lambda: None)
        self.is_waiting = False

    def act(self) -> float:
        """Go on; returns the seconds until this thread is due again."""
        if not self.is_waiting:
            self._current = greenlet(self._turn)
        self.is_waiting = True
        pause_s = float(self._current.switch())
        self.is_waiting = not self._current.dead
        return pause_s

    def is_of(self, current: object) -> bool:
        """Tell whether this turn is the one that waits here."""
        return self.is_waiting and self._current is current

    def end(self) -> None:
        """The process is gone, and this turn is not finished."""
        if self.is_waiting:
            self._current.throw(GreenletExit)
        self.is_waiting = False


class Connections:
    """All connections of the run that is on."""

    now: ClassVar["Connections"]

    def __init__(
        self, clock: "SimulatedClock", brokers: "dict[str, Broker]", is_dead: Callable[[], bool]
    ) -> None:
        self.clock, self.brokers, self.is_dead = clock, brokers, is_dead
        self.clients: list[Client] = []
        self.sinks: dict[str, MqttSink] = {}
        """Of the life that is on, by broker."""
        self.turns: dict[str, Turns] = {}
        """Of the station's threads that use a connection, by name."""
        self.on_news: Callable[[], None] = lambda: None
        """Called when a connection of the station has read something."""
        self.let_all_wait: Callable[[float], None] = clock.sleep
        self.is_ending = False
        """No turn goes on."""
        self.answer: Callable[[Callable[[str, bytes], bytes], str, bytes], bytes]
        """Do a request on a thread of its own."""

    def connect(self, client: "Client", host: str) -> socket.socket:
        """Connect to a broker. Errors: OSError where it is away."""
        broker = self.brokers[host]
        if broker.mood == "away" or self.is_dead():
            broker.said["away"] += 1
            raise ConnectionRefusedError(111, "Connection refused")
        ours, theirs = socket.socketpair()
        broker.accept(theirs)
        self.clients.append(client)
        return ours

    def pump(self) -> None:
        """Let each broker do what has come, and the station read what is answered."""
        for broker in self.brokers.values():
            broker.work()
        heard = [client.read() for client in self.clients]
        self.clients = [client for client in self.clients if client.socket() is not None]
        if any(heard):
            self.on_news()

    def next_ns(self) -> int:
        """When a broker answers next."""
        return min((broker.next_ns for broker in self.brokers.values()), default=1 << 62)

    def drain(self) -> None:
        """Let all sinks send what they have, beside each other, for a moment (docs/mqtt.md: what is left is sent by the
        next process)."""
        until_ns = self.clock.now_ns + round(DRAINED_S * S)
        has_begun = {name: not self.turns[name].is_waiting for name in self.sinks}
        going = list(self.sinks)
        while going and self.clock.now_ns < until_ns and not self.is_dead():
            for name in tuple(going):
                turns = self.turns[name]
                pause_s = turns.act()
                if has_begun[name] and pause_s > 0 and not turns.is_waiting:
                    going.remove(name)
                # A step that began before has not seen the last messages.
                has_begun[name] |= not turns.is_waiting
            if going and all(self.turns[name].is_waiting for name in going):
                self.clock.sleep(0.01)

    def settle(self, name: str) -> None:
        """Let a turn come to its end."""
        while self.turns[name].is_waiting:
            self.clock.sleep(max(0.001, self.turns[name].act()))

    def end_turns(self) -> None:
        """The process is gone."""
        for turns in self.turns.values():
            turns.end()
            self.is_ending = False
        self.sinks.clear()

    def close(self) -> None:
        """The run is over."""
        for client in self.clients:
            client.leave()
        for broker in self.brokers.values():
            broker.close()

    @property
    def can_wait(self) -> bool:
        """It is the turn of an actor, so that others can take theirs meanwhile."""
        return getcurrent().parent is not None

    def wait(self, is_over: Callable[[], bool], lasts_s: float, poll_s: float = 3600.0) -> None:
        """Wait while others take their turns. Where nobody can, it returns at once. poll_s: it looks again so soon."""
        until_ns, here = self.clock.now_ns + round(lasts_s * S), getcurrent()
        while not (self.is_dead() or self.is_ending):
            self.pump()
            if is_over() or self.clock.now_ns >= until_ns or not self.can_wait:
                return
            due_ns = max(
                min(until_ns, self.next_ns(), self.clock.now_ns + round(poll_s * S)), self.clock.now_ns
            )
            here.parent.switch((due_ns - self.clock.now_ns) / S)


class TurnLock:
    """A lock of a sink: who waits for it lets the turn go on that holds it."""

    def __init__(self, connections: Connections) -> None:
        self._connections, self._is_held = connections, False

    def __enter__(self) -> None:
        self._connections.wait(lambda: not self._is_held, ANSWERED_S, 0.01)
        self._is_held = True

    def __exit__(self, *_: object) -> None:
        self._is_held = False


class Client(paho.Client):
    """The library's client, without its thread."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._answered = set[tuple[int, int]]()
        self._packets = 0

    def loop_start(self) -> paho.MQTTErrorCode:
        self._wait((CONNACK, 0), CONNECTED_S)
        return paho.MQTTErrorCode.MQTT_ERR_SUCCESS

    def publish(self, *arguments: Any, **options: Any) -> paho.MQTTMessageInfo:
        if arguments[0].endswith("/result"):
            sent_ns, press_id = (
                Connections.now.brokers[self._host].sent_ns,
                json.loads(arguments[1])["press_id"],
            )
            sent_ns.setdefault(press_id, Connections.now.clock.now_ns)
        info = super().publish(*arguments, **options)
        if arguments[2]:
            self._wait((4, info.mid), ANSWERED_S)
        return info

    def subscribe(self, *arguments: Any, **options: Any) -> tuple[paho.MQTTErrorCode, int | None]:
        code, number = super().subscribe(*arguments, **options)
        if number is not None:
            self._wait((9, number), ANSWERED_S)
        return code, number

    def read(self) -> bool:
        """Read all that has come; returns whether something has."""
        before = self._packets
        while self._sock is not None:
            packets = self._packets
            self.loop_read()
            if self._packets == packets:
                break
        if self._sock is not None:
            self.loop_misc()
            self.loop_write()
        return self._packets != before or self._sock is None

    def leave(self) -> None:
        """Close the socket."""
        self._sock_close()

    def _wait(self, packet: tuple[int, int], lasts_s: float) -> None:
        Connections.now.wait(lambda: packet in self._answered or self._sock is None, lasts_s)
        self._answered.discard(packet)

    def _packet_handle(self) -> paho.MQTTErrorCode:
        kind, body = self._in_packet["command"] >> 4, self._in_packet["packet"]
        self._packets += 1
        code = super()._packet_handle()
        self._answered.add((kind, 0 if kind == CONNACK else int.from_bytes(body[:2], "big")))
        return code

    def _create_socket_connection(self) -> socket.socket:
        return Connections.now.connect(self, self._host)

    def _sock_send(self, data: bytes | bytearray) -> int:
        return len(data) if Connections.now.is_dead() else super()._sock_send(data)


class SimulatedMqtt:
    """The plugin of the MQTT sink, which is not started, for its turns are drawn."""

    Options = MqttOptions

    def open(self, options: MqttOptions, station: Station) -> MqttSink:
        now = Connections.now
        do = station.on_command
        assert do is not None
        heard = replace(station, on_command=lambda verb, payload: now.answer(do, verb, payload))
        at_once = options.model_copy(update={"acknowledge_s": AT_ONCE_S})
        sink = now.sinks[options.host] = Mqtt().make(at_once, heard, now.clock)
        sink._publishing = TurnLock(now)  # type: ignore[assignment]
        now.brokers[options.host].root = station.root
        return sink


mqtt_plugin = SimulatedMqtt()


@contextmanager
def connecting(connections: Connections) -> Iterator[None]:
    """Let the program connect to the brokers of a run."""
    real, time_func, Connections.now = paho.Client, paho.time_func, connections
    paho.Client, paho.time_func = Client, lambda: connections.clock.now_ns / S  # type: ignore[misc]
    try:
        yield
    finally:
        paho.Client, paho.time_func = real, time_func  # type: ignore[misc]
        connections.close()
