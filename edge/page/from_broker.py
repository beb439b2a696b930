"""The page of a station that is somewhere else: what it shows comes from a broker, and changes go there, signed."""

import json
import logging
import queue
import threading
import time
from contextlib import suppress
from typing import Final

from edge.core.errors import GelgateError, SinkError
from edge.core.ports import Clock, Message
from edge.core.sentence import Sentence
from edge.core.sink_context import TOPIC_VERSION, PageRequests
from edge.messaging.command_payloads import CommandRequest, CommandResponse, signature_of, signed_text
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.messaging.subscriber import RETURN_S, Inbox, listening, next_message
from edge.page.shown import Shown

__all__ = ["BrokerStation", "page_requests"]

log = logging.getLogger(__name__)

# The station answers within 5 s; a broker far away takes longer.
ANSWER_S: Final = 15.0

# A station that runs speaks of its contact every two seconds.
SILENT_S: Final = 8

# For a new bundle it has two minutes.
DRAWN_S: Final = 135.0

# Those that the page has buttons for; the station says which of them it serves.
VERBS: Final = frozenset(
    {"select_part", "begin_piece", "acknowledge_alarm", "replace_gel", "confirm_press", "set_regions"}
)


class BrokerStation:
    """Shows one station from its messages at a broker, until `close`; one thread, started by `start`.

    topic_filter: of one station, or of several: then the first that is heard is shown, and the others are named in the
    log.
    """

    def __init__(self, broker: Broker, topic_filter: str, answer_s: float = ANSWER_S) -> None:
        self.shown = Shown("", f"no connection to broker {broker} yet")
        self._broker = broker
        self._filter = topic_filter
        self._answer_s = answer_s
        self._closing = threading.Event()
        self._connection: Connection | None = None
        self._inbox: Inbox | None = None
        self._root: str | None = None
        self._others: set[str] = set()
        self._why_away = ""
        # From then on it has been silent for too long; None: it need not speak.
        self._silent_at: float | None = None
        self._asked: list[tuple[str, queue.SimpleQueue[bytes]]] = []
        self._thread = threading.Thread(target=self._keep_listening, name="page-broker", daemon=True)

    def start(self) -> None:
        """Listen from now on. A broker that is away is no error: the page says so, and it is tried again."""
        self._thread.start()

    def close(self) -> None:
        """End the connection. May be called again."""
        self._closing.set()
        inbox = self._inbox
        if inbox is not None:
            inbox.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def ask(self, verb: str, payload: bytes) -> bytes:
        """Publish the request, and return the station's answer. Errors: GelgateError, one sentence."""
        transaction = str(json.loads(payload)["transaction"])
        within_s = DRAWN_S if verb == "set_regions" else self._answer_s
        connection, root = self._connection, self.root
        if connection is None:
            raise GelgateError(f"nothing was asked: {self.shown.station()['away']}")
        asked = transaction, queue.SimpleQueue[bytes]()
        self._asked.append(asked)
        try:
            connection.publish(Message(f"{root}/cmd/{verb}", payload, expiry_s=max(1, round(self._answer_s))))
            return asked[1].get(timeout=within_s)
        except queue.Empty:
            raise GelgateError(
                f"the station did not answer within {within_s:g} s; `gelgate station acts` there says whether "
                "it was done"
            ) from None
        finally:
            self._asked.remove(asked)

    @property
    def root(self) -> str:
        """The root of the shown station's topics. Errors: GelgateError before it is known."""
        if self._root is None:
            raise GelgateError(f"nothing was asked: {self.shown.station()['away']}")
        return self._root

    def _keep_listening(self) -> None:
        try:
            while not self._closing.is_set():
                try:
                    self.listen()
                except SinkError as error:
                    why = Sentence(f"{error}; trying again")
                    if why != self._why_away:  # once, and not with each attempt
                        log.warning("%s", why)
                    self._why_away = why
                    self.shown.set_away(why)
                    self._closing.wait(RETURN_S)
        finally:
            if not self._closing.is_set():  # a page that goes on looks as if nothing happened
                self.shown.set_away(
                    Sentence("the page listens no more after a fault, see its log; start it again")
                )

    def listen(self) -> None:
        """Listen until `close`. Errors: SinkError when there is no connection, or when it is lost."""
        with listening(self._broker, self._filter) as (connection, inbox):
            self._inbox = inbox
            self._begin(connection)
            try:
                while not self._closing.is_set():
                    at = self._silent_at
                    left_s = None if at is None else max(0.0, at - time.monotonic())
                    if (message := next_message(inbox, left_s)) is None:
                        self._note_silence()
                    else:
                        self.see(message)
            except SinkError:
                if not self._closing.is_set():
                    raise
            finally:
                self._connection = None

    def _begin(self, connection: Connection) -> None:
        """Begin with an empty status: the retained messages lack what is over since the last connection."""
        self._connection, self._why_away, self._silent_at = connection, "", None
        log.info("listening to broker %s", self._broker)
        self.shown.forget_status()
        self.shown.set_away(
            Sentence(
                f"broker {self._broker} has no message of a station below {self._filter} yet; check the names, and "
                "that its gateway runs"
            )
        )

    def _note_silence(self) -> None:
        """A frozen gateway, or a network that is silent, is lost to the broker, or to us, much later."""
        self._silent_at = None
        self.shown.set_away(
            Sentence(
                f"nothing has come from the station for {SILENT_S} s; check its gateway, the broker, and the network "
                "between"
            )
        )

    def see(self, message: Received) -> None:
        """Show it, or give it to who waits for it. What is no message of a station is left, with a line in the log."""
        root, sign, topic = message.topic.partition(f"/gel/{TOPIC_VERSION}/")
        if not sign or not self._is_shown(f"{root}/gel/{TOPIC_VERSION}"):
            return
        if topic.startswith("cmd/"):
            self._see_answer(topic, message.payload)
            return
        self.shown.set_away(None)
        if topic == "contact" and not message.retain:
            self._silent_at = time.monotonic() + SILENT_S
        try:
            self.shown.see(Message(topic, message.payload))
        except ValueError as error:
            log.warning("a message on %.200r is not shown: %s", message.topic, error)
        if (self.shown.station()["state"] or {}).get("state") in ("stopped", "lost"):
            self._silent_at = None

    def _is_shown(self, root: str) -> bool:
        if self._root is None:
            self._root = root
            self.shown.at("/".join(root.split("/")[1:-2]))
        elif root != self._root and root not in self._others and len(self._others) < 100:
            self._others.add(root)
            log.warning(
                "the page shows %s; messages of %.200r are left out: name the one with --site, --line and --station",
                self._root,
                root,
            )
        return root == self._root

    def _see_answer(self, topic: str, payload: bytes) -> None:
        if not topic.endswith("/response"):
            return
        with suppress(ValueError, RecursionError):
            answer = _read_answer(payload)
            for transaction, waiting in list(self._asked):
                if transaction == answer.transaction:
                    waiting.put(answer.encode())


def _read_answer(payload: bytes) -> CommandResponse:
    """Fields of a newer station are left out. Errors: ValueError, RecursionError."""
    content = json.loads(payload)
    if not isinstance(content, dict):
        raise ValueError("expected a JSON object")
    known = {key: value for key, value in content.items() if key in CommandResponse.model_fields}
    return CommandResponse.model_validate(known)


def page_requests(station: BrokerStation, secret: bytes, clock: Clock) -> PageRequests:
    """Requests from the page to the station, signed with its secret. What the page refuses is in the log alone: the
    table of acts is the station's."""

    def answer(verb: str, error: str) -> bytes:
        return CommandResponse.of(clock.time_ns(), verb, error).encode()

    def do(verb: str, payload: bytes) -> bytes:
        # The secret opens all that the station serves signed, the page's token does not.
        if verb not in VERBS:
            return answer(verb, f"this page has no request '{verb:.64}'; ask the station itself")
        try:
            asked = CommandRequest.model_validate_json(payload)
            by, now_ns = f"{asked.by}, at a page"[:64] if asked.by else "page", clock.time_ns()
            text = signed_text(station.root, verb, asked.transaction, now_ns, by, asked.arguments)
            signed = {"by": by, "time_ns": now_ns, "signature": signature_of(secret, text)}
            return station.ask(verb, asked.model_copy(update=signed).model_dump_json().encode())
        except (GelgateError, ValueError) as error:
            return answer(verb, str(error))

    def refuse(verb: str, payload: bytes, why: str) -> bytes:
        log.warning("command %.64r was refused at the page: %s", verb, why)
        return answer(verb, why)

    return PageRequests(VERBS, do, refuse)
