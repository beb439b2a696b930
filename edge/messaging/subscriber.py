"""Subscribes to stations: results as they arrive, each press once, and their heatmaps into a folder."""

import json
import os
import queue
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from edge.clock import local_time
from edge.core.errors import SinkUnavailable
from edge.core.imaging.image_bytes import kind as picture_kind
from edge.core.printable import score_texts, write_count
from edge.core.sink_context import TOPIC_VERSION
from edge.messaging.mqtt_broker import Broker, Received, read_password, tls_context
from edge.messaging.mqtt_connection import Connection
from edge.store.ulid import is_ulid

__all__ = [
    "RETURN_S",
    "Inbox",
    "Seen",
    "broker_at",
    "describe",
    "listening",
    "next_message",
    "receive",
    "station_filter",
    "watch",
]

# Press ids remembered in order to leave out repetitions: more than an outbox replays at once.
REMEMBERED: Final = 100_000

# The longest wait for the picture of the last wanted press; it follows its result at once, unless the network is slow.
LAST_PICTURE_S: Final = 10.0

# The state of each station is retained, and comes at once.
QUIET_S: Final = 3.0

# Pauses between attempts to return to a broker that went away.
RETURN_S: Final = 1.0

Inbox = queue.SimpleQueue[Received | None]
"""Received messages in order; None at the end of the connection."""


@dataclass(frozen=True)
class Seen:
    """One received message."""

    kind: str
    """`result`, `heatmap`, `state` or `alarm`."""
    station: str
    """The levels before `/gel/`."""
    content: Mapping[str, Any]
    """The JSON payload; for a heatmap its `press_id` and the `path` it was saved to, None for an empty one; for an
    alarm its id too."""


def broker_at(
    host: str, port: int, client: str, username: str | None, password_file: Path | None, ca: Path | None
) -> Broker:
    """Name the broker of a command line. client: of the client id, which also has the number of the process.

    Errors: ConfigError for a file that cannot be used.
    """
    password = None if password_file is None else read_password(password_file)
    tls = None if ca is None else tls_context(ca)
    return Broker(host, port, f"gelgate-{client}-{os.getpid()}", username, password, tls)


def station_filter(prefix: str, site: str = "+", line: str = "+", station: str = "+") -> str:
    """The topic filter for these stations; `+` stands for any."""
    return f"{prefix}/{site}/{line}/{station}/gel/{TOPIC_VERSION}/#"


def watch(
    broker: Broker,
    topic_filter: str,
    save: Path | None = None,
    count: int | None = None,
    timeout_s: float | None = None,
    tell: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Seen]:
    """The received messages, until `count` results or `timeout_s` seconds, else for ever. A press id comes once.

    save: heatmaps become `<press id>.jpg` or `.png` there. tell: called with problems that do not end the watch.
    Errors: SinkUnavailable if there is no broker at the start, or the subscription is refused.
    """
    end = _End.after(timeout_s)
    known: OrderedDict[str, None] = OrderedDict()
    newest: dict[str, int] = {}
    wanted, awaited = count, None
    for message in _receive(broker, topic_filter, end, tell):
        seen = _interpret(message, save, tell)
        if seen is None:
            continue
        if seen.kind == "result":
            if seen.content["press_id"] in known or awaited is not None:
                continue  # a repetition; or all results have come, and only the last one's picture is missing
            known[seen.content["press_id"]] = None
            if len(known) > REMEMBERED:
                known.popitem(last=False)
            _tell_missing(seen, newest, tell)
        yield seen
        if seen.kind == "heatmap" and seen.content["press_id"] == awaited:
            return
        if seen.kind == "result" and wanted is not None:
            wanted -= 1
            if wanted == 0 and (save is None or not seen.content.get("heatmap_topic")):
                return
            if wanted == 0:
                awaited = seen.content["press_id"]
                end.not_after(time.monotonic() + LAST_PICTURE_S)


def _tell_missing(seen: Seen, newest: dict[str, int], tell: Callable[[str], None]) -> None:
    """Tell which results of the station have not come. newest: the highest number heard of each station, changed."""
    number, last = seen.content.get("sequence"), newest.get(seen.station)
    if not isinstance(number, int) or (last is None and len(newest) >= REMEMBERED):
        return
    if last is not None and number > last + 1:
        missing = write_count(number - last - 1, "result")
        tell(
            f"{seen.station}: {missing} between {last} and {number} did not come here; its `gelgate history` has them"
        )
    newest[seen.station] = max(number, last or number)


def receive(
    broker: Broker,
    topic_filter: str,
    timeout_s: float | None = None,
    tell: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Received]:
    """Every message, for `timeout_s` seconds, else for ever. tell, errors: as `watch`."""
    return _receive(broker, topic_filter, _End.after(timeout_s), tell)


def describe(result: Mapping[str, Any], station: str) -> str:
    """A result as one line: time, station, verdict, score, cause, gel, latency."""
    verdict, score, threshold = result.get("verdict"), result.get("score"), result.get("threshold")
    time_ns = result.get("time_ns")
    moment = local_time(time_ns) if isinstance(time_ns, int) and 0 <= time_ns < 1 << 63 else "?"
    words = [moment, station, str(result.get("part", "?"))]
    if result.get("position"):
        words.append(str(result["position"]))
    words.append(str(verdict or "error").upper())
    if score is not None and threshold is not None:
        is_above, texts = score > threshold, score_texts(score, threshold, form="g")
        words.append(f"score {texts[0]} {'>' if is_above else '<='} {texts[1]}")
    words += [str(result[key]) for key in ("reason", "error") if result.get(key)]
    if result.get("cause"):
        words.append(f"cause {result['cause']}: {result.get('cause_text') or '?'}")
    words.append(f"gel {result.get('gel_presses', '?')}/{result.get('gel_limit_presses', '?')}")
    total = (result.get("latency_ms") or {}).get("total")
    if total is not None:
        words.append(f"{total:.1f} ms")
    return "  ".join([*words, "(late)"] if result.get("is_replayed") else words)


@dataclass
class _End:
    """When to stop listening, by the monotonic clock; None for never."""

    at: float | None

    @classmethod
    def after(cls, timeout_s: float | None) -> Self:
        return cls(None if timeout_s is None else time.monotonic() + timeout_s)

    def not_after(self, moment: float) -> None:
        self.at = moment if self.at is None else min(self.at, moment)

    def seconds_left(self) -> float | None:
        return None if self.at is None else max(0.0, self.at - time.monotonic())


def _receive(broker: Broker, topic_filter: str, end: _End, tell: Callable[[str], None]) -> Iterator[Received]:
    has_listened = False
    while True:
        try:
            with listening(broker, topic_filter) as (_, inbox):
                tell(
                    f"listening to broker {broker}{' again' if has_listened else f', topics {topic_filter}'}"
                )
                if not has_listened:
                    has_listened = True
                    left_s = end.seconds_left()
                    first = next_message(inbox, QUIET_S if left_s is None else min(QUIET_S, left_s))
                    if first is None:
                        tell("no station is heard; check the names, and that its gateway has run")
                    else:
                        yield first
                while (message := next_message(inbox, end.seconds_left())) is not None:
                    yield message
            return
        except SinkUnavailable as error:
            if not has_listened:
                raise
            tell(f"{error}; trying again")
            seconds_left = end.seconds_left()
            if seconds_left is not None and seconds_left < RETURN_S:
                return
            time.sleep(RETURN_S)


@contextmanager
def listening(broker: Broker, topic_filter: str) -> Iterator[tuple[Connection, Inbox]]:
    """A connection with this subscription, and what it receives; closed at the end. Errors: SinkError."""
    inbox: Inbox = queue.SimpleQueue()
    connection = Connection.open(broker, on_received=inbox.put, on_lost=lambda: inbox.put(None))
    try:
        connection.subscribe(topic_filter)
        yield connection, inbox
    finally:
        connection.close()


def next_message(inbox: Inbox, timeout_s: float | None) -> Received | None:
    """The next message, None when the time is over. Errors: SinkUnavailable when the connection is lost."""
    try:
        message = inbox.get(timeout=timeout_s)
    except queue.Empty:
        return None
    if message is None:
        raise SinkUnavailable("the connection to the broker is lost")
    return message


def _interpret(message: Received, save: Path | None, tell: Callable[[str], None]) -> Seen | None:
    station, _, topic = message.topic.partition(f"/gel/{TOPIC_VERSION}/")
    kind, _, name = topic.partition("/")
    if kind == "heatmap" and save is not None and is_ulid(name):  # nothing else may become the name of a file
        if not message.payload:
            tell(f"{station} has no picture of press {name}: it could not be drawn")
            return Seen("heatmap", station, {"press_id": name, "path": None})
        if (form := picture_kind(message.payload)) is None:
            tell(f"the picture of press {name} is left out: it is neither a JPEG nor a PNG")
            return None
        path = save / f"{name}.{form}"
        save.mkdir(parents=True, exist_ok=True)
        path.write_bytes(message.payload)
        return Seen("heatmap", station, {"press_id": name, "path": str(path)})
    if kind not in ("result", "state", "alarm") or (kind == "alarm" and not message.payload):
        return None
    try:
        content = json.loads(message.payload)
        if not isinstance(content, dict) or (kind == "result" and not _is_result(content)):
            raise ValueError("not a payload of this topic")
    except (ValueError, RecursionError) as error:
        tell(f"a message on {message.topic} cannot be read ({error}); it is left out")
        return None
    return Seen(kind, station, content)


def _is_result(content: Mapping[str, Any]) -> bool:
    """Tell whether `describe` can print it. Anybody may publish; a newer station may add fields."""
    press_id, latency = content.get("press_id"), content.get("latency_ms") or {}
    total = latency.get("total") if isinstance(latency, dict) else ""
    numbers = (content.get("score"), content.get("threshold"), total)
    return (
        isinstance(press_id, str)
        and is_ulid(press_id)
        and all(n is None or (isinstance(n, (int, float)) and abs(n) < 1e300) for n in numbers)
    )
