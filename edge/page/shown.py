"""What the page shows: the newest messages of one station, bounded, as JSON."""

import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple

from pydantic import ValidationError

from edge.core.ports import Message
from edge.core.sink_context import topic_level
from edge.messaging.alarm_payload import Alarm, list_alarms
from edge.messaging.payload_base import Payload
from edge.messaging.topics import TOPICS
from edge.pictures.image_file import content_type, texts
from edge.store.ulid import is_ulid

__all__ = [
    "EARLIER_PRESSES",
    "LARGEST_PAYLOAD_BYTES",
    "MOST_ASKED",
    "MOST_FOREIGN_ALARMS",
    "MOST_PICTURES",
    "MOST_PRESSES",
    "Shown",
    "readable",
]

# Results that are shown, and of how many the picture is kept, but for those that a person is asked about; a picture has
# at most 2 MiB.
MOST_PRESSES: Final = 50
MOST_PICTURES: Final = 12
EARLIER_PRESSES: Final = 12
MOST_ASKED: Final = 20
LARGEST_PICTURE_BYTES: Final = 4 << 20
# Alarms that are not known here; a flood of names hides none that is known.
MOST_FOREIGN_ALARMS: Final = 16

# The messages of one press come within this time.
SETTLE_S: Final = 0.06

# The largest payload that is read; those of a station have a few thousand bytes.
LARGEST_PAYLOAD_BYTES: Final = 64 << 10

# By the first level of a topic.
_MODELS: Final[Mapping[str, type[Payload]]] = {
    topic.name.partition("/")[0]: topic.payload
    for topic in TOPICS
    if isinstance(topic.payload, type) and issubclass(topic.payload, Payload)
}

_STATUS: Final = ("state", "info", "gel", "reference", "piece", "contact", "questions", "drift", "stats")


class Picture(NamedTuple):
    """A picture of a press: its file and content type."""

    data: bytes
    content_type: str


class Shown:
    """The newest messages. Any thread may use it.

    place: site/line/station, empty where it is not known yet. away: why nothing new comes, as one sentence. draw:
    draws the picture of a press of before the start, or of one that a person is asked about, that is not here; empty
    where it cannot. None without an archive. earlier: results of before the start, oldest first; none of them is the
    verdict on the part that lies there now, and neither is one of before an interruption, nor a pass of before a master
    piece: lights have forgotten it.
    """

    def __init__(
        self,
        place: str,
        away: str | None = None,
        draw: Callable[[str], bytes] | None = None,
        earlier: Iterable[Mapping[str, Any]] = (),
    ) -> None:
        self._changed = threading.Condition()
        self._version = 1
        self._is_closed = False
        self._place = place
        self._away = away
        self._status: dict[str, Any] = dict.fromkeys(_STATUS)
        self._known_alarms = list_alarms()
        self._alarms: dict[str, Any] = {}
        self._presses: OrderedDict[str, Any] = OrderedDict(
            (one["press_id"], {**one, "is_earlier": True}) for one in earlier
        )
        self._pictures: OrderedDict[str, Picture] = OrderedDict()
        self._draw, self._drawing = draw, threading.Lock()
        self._not_drawn: set[str] = set()

    def see(self, message: Message) -> None:
        """topic: below the root. Others than those that are shown have no effect. Errors: ValueError, one sentence for
        a payload that cannot be shown."""
        kind, _, name = message.topic.partition("/")
        if kind == "heatmap":
            self._see_picture(name, message.payload)
        elif message.topic == "last/heatmap":
            self._see_last_picture(message.payload)
        elif kind == "alarm":
            self._see_alarm(name, message.payload)
        elif message.topic in ("result", "last/press"):
            content = readable("result", message.payload)
            with self._changed:
                is_retained, is_late = message.topic == "last/press", content.get("is_replayed", False)
                self._keep_press(
                    content, may_be_old=is_retained or is_late, is_late=is_late and not is_retained
                )
                self._note()
        elif message.topic in _STATUS:
            status = readable(message.topic, message.payload) if message.payload else None
            with self._changed:
                if (
                    message.topic == "state"
                    and _is_ready(status)
                    and _is_ready(self._status["state"]) is False
                ):
                    self._forget_verdict()
                self._status[message.topic] = status
                self._forget_before_master()
                self._note()

    def _forget_before_master(self) -> None:
        """As lights: who presses a part in the place of a master piece must not take the pass before for its own."""
        master, newest = self._status["reference"], next(reversed(self._presses.values()), None)
        if master is None or newest is None or newest.get("is_earlier") or newest.get("verdict") != "pass":
            return
        # On one gel the count tells which was first, and knows no clock.
        by = "gel_presses" if master["gel_id"] == newest["gel_id"] else "time_ns"
        if master[by] > newest[by]:
            self._forget_verdict()

    def _forget_verdict(self) -> None:
        self._presses = OrderedDict(
            (key, {**press, "is_earlier": True}) for key, press in self._presses.items()
        )

    def _keep_press(self, content: dict[str, Any], *, may_be_old: bool, is_late: bool) -> None:
        """An old one takes no place above newer ones: its part does not lie there any more. is_late: it was made before
        an interruption, so neither it nor one before it is the verdict of now."""
        press_id = content["press_id"]
        before = self._presses.get(press_id)
        is_old, is_late = may_be_old and before is None, is_late and before is None
        mark = {"is_earlier": True} if is_late or (before is not None and before.get("is_earlier")) else {}
        self._presses[press_id] = {**content, **mark}
        for other, known in list(self._presses.items()) if is_old else ():
            if _order(known) > _order(content):
                self._presses.move_to_end(other)
        if is_late and next(reversed(self._presses)) == press_id:
            self._forget_verdict()
        self._forget_before_master()
        while len(self._presses) > MOST_PRESSES:
            self._presses.popitem(last=False)

    def _see_picture(self, press_id: str, data: bytes) -> None:
        if not is_ulid(press_id) or len(data) > LARGEST_PICTURE_BYTES:
            raise ValueError("it is not the picture of a press")
        if not data:
            return  # it could not be drawn
        picture = Picture(data, content_type(data))
        with self._changed:
            self._pictures[press_id] = picture
            asked = self._asked()
            # Of the oldest press, not the one that came first: those of before an interruption come late.
            place = {known: n for n, known in enumerate(self._presses)}
            newest = max(place, default="")
            others = [known for known in self._pictures if known not in asked]
            # The result of a newer one may come after its picture.
            others.sort(key=lambda known: place.get(known, len(place) if known > newest else -1))
            for old in others[:-MOST_PICTURES]:
                del self._pictures[old]
            self._note()

    def _asked(self) -> list[str]:
        """The presses that a person is asked about, as far as their pictures are kept."""
        questions = (self._status["questions"] or {}).get("presses", ())[:MOST_ASKED]
        return [question["press_id"] for question in questions]

    def _see_last_picture(self, data: bytes) -> None:
        """Keep the retained picture of `last/press` for pages that are opened later. The id is in the file."""
        if data and len(data) <= LARGEST_PICTURE_BYTES:
            press_id = texts(data).get("press_id", "")
            with self._changed:
                is_new = press_id not in self._pictures
            if is_ulid(press_id) and is_new:
                self._see_picture(press_id, data)

    def _see_alarm(self, name: str, payload: bytes) -> None:
        """Show it; one of a newer station, or of a feature that is not installed here, without what to do."""
        known, kind = self._known_alarms, self._known_alarms.get(topic_level(name), Alarm())
        content = readable("alarm", payload) if payload else None
        with self._changed:
            if name == "contact" and content is not None and self._presses:
                newest = next(reversed(self._presses.values()))
                if newest.get("verdict") == "pass":  # as with lights: another part may lie there
                    self._forget_verdict()
            if content is None:
                self._alarms.pop(name, None)
            elif name in {*known, *self._alarms} or len(self._alarms.keys() - known) < MOST_FOREIGN_ALARMS:
                advice = {"title": kind.title, "what_to_do": kind.what_to_do, "can_acknowledge": kind.stays}
                self._alarms[name] = {**content, "alarm": name, **advice}
            self._note()

    def at(self, place: str) -> None:
        """The station is known now."""
        with self._changed:
            self._place = place
            self._note()

    def set_away(self, away: str | None) -> None:
        """Say why nothing new comes; None when it does."""
        with self._changed:
            if away != self._away:
                self._away = away
                self._note()

    def forget_status(self) -> None:
        """Forget the status before retained messages come again: what is over is not among them."""
        with self._changed:
            self._status, self._alarms = dict.fromkeys(_STATUS), {}
            self._note()

    def _note(self) -> None:
        self._version += 1
        self._changed.notify_all()

    def station(self) -> dict[str, Any]:
        """Give what the station says of itself, and `version`, which rises with every change."""
        with self._changed:
            return {
                "version": self._version,
                "place": self._place,
                "away": self._away,
                **self._status,
                "pictures": [*self._pictures, *self._to_draw()],
                "alarms": dict(self._alarms),
            }

    def presses(self) -> list[Any]:
        """Newest first; `has_picture` says whether there is one, or one can be drawn."""
        with self._changed:
            pictured = {*self._pictures, *self._to_draw()}
            return [
                {**press, "has_picture": key in pictured} for key, press in reversed(self._presses.items())
            ]

    def picture(self, press_id: str) -> Picture | None:
        """None for a press without one, and for one that is too old. Of one of before the start, and of one that a
        person is asked about, it is drawn again, where it can be."""
        with self._drawing:
            with self._changed:
                if self._draw is None or press_id not in self._to_draw():
                    return self._pictures.get(press_id)
            with suppress(ValueError):  # it is too large to be shown
                self._see_picture(press_id, self._draw(press_id))
            with self._changed:
                picture = self._pictures.get(press_id)
                if picture is None:
                    self._not_drawn.add(press_id)
                    self._note()
                return picture

    def _to_draw(self) -> list[str]:
        """The presses of before the start, and those that a person is asked about, whose pictures can be drawn."""
        known = self._pictures.keys() | self._not_drawn
        earlier = [one for one, press in self._presses.items() if press.get("is_earlier")]
        wanted = dict.fromkeys((*self._asked(), *earlier))
        return [] if self._draw is None else [one for one in wanted if one not in known]

    def wait(self, version: int, timeout_s: float) -> None:
        """Return soon after there is another version than this, when the time is over, or at the end.

        A press is several messages that come at once: they are shown together, by SETTLE_S later.
        """
        with self._changed:
            if self._version == version:
                self._changed.wait_for(lambda: self._version != version or self._is_closed, timeout_s)
                self._changed.wait_for(lambda: self._is_closed, SETTLE_S if self._version != version else 0)

    def close(self) -> None:
        """Let no one wait any more."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()


def _is_ready(state: Mapping[str, Any] | None) -> bool | None:
    """Tell whether the station inspects; None where it has not said so."""
    return None if state is None else state.get("state") == "ready"


def _order(result: Mapping[str, Any]) -> tuple[int, int]:
    """The number of a press, which knows no clock; a station of long ago says none."""
    return result.get("sequence") or 0, result["time_ns"]


def readable(kind: str, payload: bytes) -> dict[str, Any]:
    """Read the fields of a payload of this kind that can be shown. Errors: ValueError, without the payload.

    At a broker anybody may publish, and a station may be newer than this program: fields that are not known are left
    out, and so are known ones with a value that cannot be.
    """
    if len(payload) > LARGEST_PAYLOAD_BYTES:
        raise ValueError(f"it has {len(payload)} bytes, a payload has at most {LARGEST_PAYLOAD_BYTES}")
    try:
        content = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ValueError("it is not JSON") from error
    if not isinstance(content, dict):
        raise ValueError("expected a JSON object")
    model = _MODELS[kind]
    known = {key: value for key, value in content.items() if key in model.model_fields}
    for key in _faulty(model, known):
        known.pop(key, None)
    if fault := _faulty(model, known):
        raise ValueError(f"it is not what a station says ({', '.join(sorted(fault))})")
    return model.model_validate(known, strict=False).model_dump(mode="json", include=set(known))


def _faulty(model: type[Payload], content: Mapping[str, Any]) -> set[str]:
    """The fields that are not as the model has them; `fields that contradict each other` for several together.

    Lists are read as the tuples of the model, so not strictly; what is shown is what was read.
    """
    try:
        model.model_validate(dict(content), strict=False)
    except ValidationError as error:
        return {
            str(fault["loc"][0]) if fault["loc"] else "fields that contradict each other"
            for fault in error.errors(include_url=False, include_input=False, include_context=False)
        }
    return set()
