"""What every sink must do. The author supplies a bench that knows what the receiver has and can make it unreachable."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Protocol, runtime_checkable

from edge.core.errors import SinkError, SinkRejected, SinkUnavailable
from edge.core.gel_life import GelState
from edge.core.ports import Message, Sink
from edge.core.sink_context import Station
from edge.core.verdict import Kind
from edge.messaging.result_payload import ResultPayload
from edge.messaging.status_payloads import GelPayload
from edge.store.ulid import new_ulid
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["ROOT", "SINK_CHECKS", "SinkBench", "Translates", "check_sink"]

ROOT: Final = "gelgate/plant/line1/station1/gel/v1"
STATION: Final = Station(ROOT, "station1")
_T0_NS: Final = 1_769_860_800 * 10**9
# How often a message is sent again to a receiver that returns; the bench waits in between.
_ATTEMPTS: Final = 400


class SinkBench(Protocol):
    """One receiver with its sink under test."""

    def open(self, station: Station) -> Sink:
        """The sink, opened by its plugin."""

    def received(self, n: int) -> Sequence[tuple[str, bytes]]:
        """The first n messages at the receiver, after waiting for them: (full topic, payload)."""

    def take_away(self) -> bool:
        """Make the receiver unreachable; False if that is not possible."""

    def bring_back(self) -> None:
        """Make it reachable again."""

    def wait(self) -> None:
        """Wait as long as a retry needs."""

    def unwanted(self) -> Message | None:
        """A message that this receiver refuses, None if it takes everything."""


@runtime_checkable
class Translates(Protocol):
    """A bench whose sink leaves messages out, or writes them in another form."""

    def arrives(self, topic: str, message: Message) -> tuple[str, bytes] | None:
        """Return what the receiver has of a message, (topic, payload), None for nothing; topic: the full one."""


def check_sink(make_bench: Callable[[], SinkBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("sink", SINK_CHECKS, make_bench)


def check_messages_arrive(bench: SinkBench) -> None:
    """When `send` returns the message is at the receiver: below the station's root, in order, unchanged."""
    sink = bench.open(STATION)
    require(isinstance(sink, Sink), f"{type(sink).__name__} lacks a part of Sink")
    sent = [_result(1), Message("heatmap/1", b"\x89PNG", content_type="image/png")]
    sent += [_gel()]
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
    sink.send(_result(1))
    sink.close()


def check_threads(bench: SinkBench) -> None:
    """Messages of several threads all arrive."""
    sink = bench.open(STATION)
    messages = [_result(n) for n in range(40)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(sink.send, messages))
    expected = _expect(bench, messages)
    arrived = bench.received(len(expected))
    missing = sorted(set(expected) - set(arrived))
    words = f"{len(arrived)} messages arrived, expected {len(expected)}; not as sent: {missing[:1]}"
    require(sorted(arrived) == sorted(expected), words)
    sink.close()


def check_a_receiver_that_is_away(bench: SinkBench) -> None:
    """Sending without a receiver is SinkUnavailable, and passes when the receiver is back."""
    sink = bench.open(STATION)
    sink.send(_result(1))
    if bench.take_away():
        raises(SinkUnavailable, "send without a receiver", lambda: sink.send(_result(2)))
        bench.bring_back()
        _send_when_back(bench, sink)
    sink.close()


def check_a_receiver_that_is_away_at_the_start(bench: SinkBench) -> None:
    """Opening without a receiver is no error; sending is SinkUnavailable until the receiver is reachable."""
    if bench.take_away():
        sink = bench.open(STATION)
        raises(SinkUnavailable, "send without a receiver", lambda: sink.send(_result(1)))
        bench.bring_back()
        _send_when_back(bench, sink)
        sink.close()


def check_a_message_that_is_refused(bench: SinkBench) -> None:
    """A refused message is SinkRejected, which is not tried again, and the next message passes."""
    message = bench.unwanted()
    if message is not None:
        sink = bench.open(STATION)
        raises(SinkRejected, "a message that the receiver refuses", lambda: sink.send(message))
        sink.send(_result(1))
        sink.close()


def check_closed_twice(bench: SinkBench) -> None:
    """Closing twice is harmless; a later message is delivered or a SinkError, never lost in silence."""
    sink = bench.open(STATION)
    sink.send(_result(1))
    sink.close()
    sink.close()
    try:
        sink.send(_result(2))
    except SinkError:
        return
    both = len(_expect(bench, [_result(1), _result(2)]))
    require(len(bench.received(both)) == both, "a message sent after `close` is lost")


SINK_CHECKS: Final[tuple[Callable[[SinkBench], None], ...]] = collect(globals(), SinkBench)


def _expect(bench: SinkBench, messages: Sequence[Message]) -> list[tuple[str, bytes]]:
    """Return what the receiver has of these messages, in order."""
    sent = ((f"{ROOT}/{message.topic}", message) for message in messages)
    if not isinstance(bench, Translates):
        return [(topic, message.payload) for topic, message in sent]
    return [one for topic, message in sent if (one := bench.arrives(topic, message)) is not None]


def _result(n: int) -> Message:
    """Make the result of press number n, as a station sends it: a sink may write some of its fields alone."""
    time_ns = _T0_NS + n * 10**9
    result = ResultPayload(
        time_ns=time_ns,
        press_id=new_ulid(time_ns, lambda k: n.to_bytes(k, "big")),
        part="bolt",
        verdict=Kind.PASS,
        score=0.5,
        threshold=1.0,
        score_ratio=0.5,
        sensor_serial="S",
        gel_id="S-1",
        gel_presses=n,
        gel_limit_presses=1000,
    )
    return Message("result", result.encode())


def _gel() -> Message:
    return GelPayload(
        time_ns=_T0_NS, sensor_serial="S", gel_id="S-1", presses=2, limit_presses=1000, state=GelState.GOOD
    ).message()


def _send_when_back(bench: SinkBench, sink: Sink) -> None:
    for _ in range(_ATTEMPTS):
        try:
            return sink.send(_result(3))
        except SinkUnavailable:
            bench.wait()
    raise AssertionError("the receiver is back, and the sink does not deliver")
