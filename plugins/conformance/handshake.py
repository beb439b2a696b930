"""What every server for a PLC must do. The author supplies a bench with a client of its protocol."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Protocol

from edge.core.digital_io import StationView
from edge.core.handshake import Code, Handshake, HandshakeServer, HandshakeView, Refusal, Trigger
from plugins.conformance.running import collect, raises, require, run_all

__all__ = ["HANDSHAKE_CHECKS", "HandshakeBench", "PlcClient", "Seen", "check_handshake"]


@dataclass(frozen=True)
class Seen:
    """What a client reads, in any protocol."""

    is_ready: bool
    is_busy: bool
    is_done: bool
    word: str | None
    """The result."""
    trigger_id: int

    @classmethod
    def of(cls, view: HandshakeView) -> "Seen":
        """Return what must be read of this view."""
        step = view.step
        return cls(view.is_ready, step == "busy", step == "done", view.word, view.trigger_id)


class PlcClient(Protocol):
    """A connected PLC."""

    def trigger(self, trigger: Trigger) -> bool:
        """Ask for it; False where the server refuses."""

    def acknowledge(self) -> bool: ...

    def beat(self) -> None:
        """Give a sign of life, at least one."""

    def read(self) -> Seen: ...

    def close(self) -> None: ...


class HandshakeBench(Protocol):
    """One server under test, at a free port."""

    def open(self) -> HandshakeServer:
        """The server, opened by its plugin; once."""

    def connect(self) -> PlcClient:
        """A client. Errors: any, where nothing is served."""


class _Scripted:
    """A `Handshake` that shows what a check says, and notes what it is asked."""

    def __init__(self) -> None:
        self.view = HandshakeView(station=StationView("ready"), is_ready=True)
        self.refusal: Refusal | None = None
        self.triggers: list[Trigger] = []
        self.acknowledged = self.beats = 0
        self._lock = threading.Lock()

    def read(self) -> HandshakeView:
        return self.view

    def trigger(self, trigger: Trigger) -> Refusal | None:
        with self._lock:
            self.triggers.append(trigger)
        return self.refusal

    def acknowledge(self) -> None:
        with self._lock:
            self.acknowledged += 1

    def beat(self) -> None:
        with self._lock:
            self.beats += 1

    def refuse(self, what: str, sentence: str) -> None:
        require(bool(what and sentence), "a refusal without a sentence")


def check_handshake(make_bench: Callable[[], HandshakeBench]) -> None:
    """Run every check, each on a new bench. Errors: ExceptionGroup."""
    run_all("handshake", HANDSHAKE_CHECKS, make_bench)


def _serve(bench: HandshakeBench) -> tuple[HandshakeServer, _Scripted, PlcClient]:
    server, handshake = bench.open(), _Scripted()
    require(isinstance(handshake, Handshake), "the check's own handshake lacks a part")
    server.start(handshake)
    return server, handshake, bench.connect()


def check_it_has_a_name_and_may_close_unserved(bench: HandshakeBench) -> None:
    """A person can tell where it is; closing without a start, and twice, is harmless."""
    server = bench.open()
    require(isinstance(server, HandshakeServer), f"{type(server).__name__} lacks a part of HandshakeServer")
    require(bool(server.name), "it has no name")
    server.close()
    server.close()
    raises(Exception, "connecting to a closed server", bench.connect)


def check_what_is_shown_is_read(bench: HandshakeBench) -> None:
    """Every step and result, with its id, the largest too; a pass that is withdrawn is gone with the next read."""
    server, handshake, client = _serve(bench)
    ready = handshake.view
    views = [ready, replace(ready, is_ready=False), replace(ready, is_ready=False, step="busy", trigger_id=7)]
    for word in ("pass", "fail", "unsure", "rejected", "error", "pass", "error"):
        views.append(replace(views[1], step="done", word=word, trigger_id=2**32 - 1))
    for view in [*views, ready]:
        handshake.view = view
        require(client.read() == Seen.of(view), f"it is {Seen.of(view)}, a client reads {client.read()}")
    client.close()
    server.close()


def check_a_client_asks(bench: HandshakeBench) -> None:
    """Trigger with its id and texts, acknowledgement and sign of life reach the station, each once."""
    server, handshake, client = _serve(bench)
    asked = Trigger(70_000, "piece 17", "PZ0/pos1")
    require(client.trigger(asked), "a trigger that the station takes is refused")
    require(handshake.triggers == [asked], f"the station was asked {handshake.triggers}, expected {asked}")
    require(client.acknowledge(), "an acknowledgement is refused")
    require(handshake.acknowledged == 1, f"acknowledged {handshake.acknowledged} times")
    client.beat()
    require(handshake.beats > 0, "no sign of life arrives")
    client.close()
    server.close()


def check_a_refusal_is_one(bench: HandshakeBench) -> None:
    """What the station refuses the client does not take for done."""
    server, handshake, client = _serve(bench)
    for code in Code:
        if code is not Code.NONE:
            handshake.refusal = Refusal(code, "no")
            require(
                not client.trigger(Trigger(1)),
                f"a trigger is refused as {code.name}, and done for the client",
            )
    handshake.refusal = None
    require(client.trigger(Trigger(2)), "after refusals no trigger is taken")
    client.close()
    server.close()


def check_a_second_client(bench: HandshakeBench) -> None:
    """It reads what the first one reads, and changes nothing while that one is there."""
    server, handshake, client = _serve(bench)
    client.trigger(Trigger(1))
    second = bench.connect()
    require(second.read() == client.read(), "two clients read different things")
    require(not second.trigger(Trigger(2)), "the trigger of a second client is taken")
    require(not second.acknowledge(), "the acknowledgement of a second client is taken")
    require(
        (len(handshake.triggers), handshake.acknowledged) == (1, 0), "a second client reaches the station"
    )
    client.close()
    require(second.acknowledge(), "the first client is gone, and the second one may not write")
    second.close()
    server.close()


def check_a_client_that_comes_back(bench: HandshakeBench) -> None:
    """It finds what the station shows now; its going away asks the station for nothing."""
    server, handshake, client = _serve(bench)
    client.trigger(Trigger(1))
    handshake.view = replace(handshake.view, is_ready=False, step="busy", trigger_id=1)
    client.close()
    handshake.view = replace(handshake.view, step="done", word="fail")
    client = bench.connect()
    require(client.read() == Seen.of(handshake.view), f"a client that comes back reads {client.read()}")
    require((len(handshake.triggers), handshake.acknowledged) == (1, 0), "going away has asked the station")
    client.close()
    server.close()


def check_closed_while_a_client_is_there(bench: HandshakeBench) -> None:
    """It reads nothing any more: a view of a station that has ended would be a stale one."""
    server, _, client = _serve(bench)
    client.read()
    server.close()
    raises(Exception, "reading from a closed server", client.read)
    with suppress(Exception):
        client.close()
    raises(Exception, "connecting to a closed server", bench.connect)


HANDSHAKE_CHECKS: Final[tuple[Callable[[HandshakeBench], None], ...]] = collect(globals(), HandshakeBench)
