"""What every sink must do. The author supplies a bench that knows what the receiver has and can make it unreachable."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Protocol, runtime_checkable

from edge.core.errors import SinkError, SinkRejected, SinkUnavailable
from edge.core.ports import Message, Sink
from edge.core.sink_context import Station
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["ROOT", "SINK_CHECKS", "SinkBench", "Translates", "check_sink"]

ROOT: Final = "gelgate/plant/line1/station1/gel/v1"
STATION: Final = Station(ROOT, "station1")
# How often a message is sent again to a receiver that returns; the bench waits in between.
_ATTEMPTS: Final = 400


class SinkBench(Protocol):
    """One receiver with its sink under test."""

    def open(self, station: Station) -> Sink:
        """The sink, opened by its plugin."""
        ...

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        """The first n messages at the receiver, after waiting for them: (full topic, payload)."""
        ...

    def take_away(self) -> bool:
        """Make the receiver unreachable; False if that is not possible."""
        ...

    def bring_back(self) -> None:
        """Make it reachable again."""
        ...

    def wait(self) -> None:
        """Wait as long as a retry needs."""
        ...

    def unwanted(self) -> Message | None:
        """A message that this receiver refuses, None if it takes everything."""
        ...


@runtime_checkable
class Translates(Protocol):
    """A bench whose sink leaves messages out, or writes them in another form."""

    def arrives(self, topic: str, message: Message) -> tuple[str, bytes] | None:
        """Return what the receiver has of a message, (topic, payload), None for nothing; topic: the full one."""
        ...


def check_sink(make_bench: Callable[[], SinkBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("sink", SINK_CHECKS, make_bench)


def check_messages_arrive(bench: SinkBench) -> None:
    """When `send` returns the message is at the receiver: below the station's root, in order, unchanged."""
    sink = bench.open(STATION)
    require(isinstance(sink, Sink), f"{type(sink).__name__} lacks a part of Sink")
    sent = [Message("result", b'{"n":1}'), Message("heatmap/1", b"\x89PNG", content_type="image/png")]
    sent += [Message("gel", b'{"n":2}', retain=True)]
    for message in sent:
        sink.send(message)
    expected = _expect(bench, sent)
    arrived = list(bench.received(len(expected)))
    require(arrived == expected, f"the receiver has {arrived}, expected {expected}")
    sink.close()


def check_any_payload(bench: SinkBench) -> None:
    """An empty payload, invalid JSON and arbitrary bytes are delivered or refused, and the next message passes."""
    sink = bench.open(STATION)
    for payload in (b"", b"{", bytes(range(256))):
        try:
            sink.send(Message("result", payload))
        except SinkRejected:
            continue
    sink.send(Message("result", b'{"n":1}'))
    sink.close()


def check_threads(bench: SinkBench) -> None:
    """Messages of several threads all arrive."""
    sink = bench.open(STATION)
    messages = [Message("result", b'{"n":%d}' % n) for n in range(40)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(sink.send, messages))
    expected = _expect(bench, messages)
    arrived = bench.received(len(expected))
    require(sorted(arrived) == sorted(expected), f"{len(arrived)} of {len(expected)} arrived")
    sink.close()


def check_a_receiver_that_is_away(bench: SinkBench) -> None:
    """Sending without a receiver is SinkUnavailable, and passes when the receiver is back."""
    sink = bench.open(STATION)
    sink.send(Message("result", b'{"n":1}'))
    if bench.take_away():
        raises(SinkUnavailable, "send without a receiver", lambda: sink.send(Message("result", b'{"n":2}')))
        bench.bring_back()
        _send_when_back(bench, sink)
    sink.close()


def check_a_receiver_that_is_away_at_the_start(bench: SinkBench) -> None:
    """Opening without a receiver is no error; sending is SinkUnavailable until the receiver is reachable."""
    if bench.take_away():
        sink = bench.open(STATION)
        raises(SinkUnavailable, "send without a receiver", lambda: sink.send(Message("result", b'{"n":1}')))
        bench.bring_back()
        _send_when_back(bench, sink)
        sink.close()


def check_a_message_that_is_refused(bench: SinkBench) -> None:
    """A refused message is SinkRejected, which is not tried again, and the next message passes."""
    message = bench.unwanted()
    if message is not None:
        sink = bench.open(STATION)
        raises(SinkRejected, "a message that the receiver refuses", lambda: sink.send(message))
        sink.send(Message("result", b'{"n":1}'))
        sink.close()


def check_closed_twice(bench: SinkBench) -> None:
    """Closing twice is harmless; a later message is delivered or a SinkError, never lost in silence."""
    sink = bench.open(STATION)
    sink.send(Message("result", b'{"n":1}'))
    sink.close()
    sink.close()
    try:
        sink.send(Message("result", b'{"n":2}'))
    except SinkError:
        return
    both = len(_expect(bench, [Message("result", b'{"n":1}'), Message("result", b'{"n":2}')]))
    require(len(bench.received(both)) == both, "a message sent after `close` is lost")


SINK_CHECKS: Final[tuple[Callable[[SinkBench], None], ...]] = collect(globals(), SinkBench)


def _expect(bench: SinkBench, messages: Sequence[Message]) -> list[tuple[str, bytes]]:
    """Return what the receiver has of these messages, in order."""
    sent = ((f"{ROOT}/{message.topic}", message) for message in messages)
    if not isinstance(bench, Translates):
        return [(topic, message.payload) for topic, message in sent]
    return [one for topic, message in sent if (one := bench.arrives(topic, message)) is not None]


def _send_when_back(bench: SinkBench, sink: Sink) -> None:
    for _ in range(_ATTEMPTS):
        try:
            return sink.send(Message("result", b'{"n":3}'))
        except SinkUnavailable:
            bench.wait()
    raise AssertionError("the receiver is back, and the sink does not deliver")
