"""The lives of one station: opened, stepped, killed at a chosen write, and opened again from what the disk then holds.

From the point on at which it is killed the process is dead: what it still does reaches no broker, and its folder is
thrown away.
"""

import json
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from edge.config import Config
from edge.core.contact.events import PressSettled
from edge.core.errors import StoreError
from edge.core.press import Press
from edge.features.handshake.stage import HandshakeStage
from edge.features.outputs.stage import Outputs
from edge.gateway.build import open_station
from edge.gateway.command_table import every_command
from edge.gateway.opening import BundleOpener
from edge.gateway.preflight import Preflight, _describe_store
from edge.gateway.recorder import PressReport
from edge.gateway.station_loop import StationLoop
from edge.messaging.command_payloads import signature_of, signed_text
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.session import TrunkSessions
from edge.press_stage import PressStage
from edge.store.bundles_in_use import read_takeover, revision
from simulation.bundles import PARTS
from simulation.disk import Disk, hear_audits
from simulation.locks import SharedDatabase
from simulation.options import SECRET
from simulation.sensor import SERIAL, S
from simulation.surroundings import World

Row = tuple[str, str, str, str]
"""Id, verdict, part and gel."""

GAP_NS = 270_000_000
"""Frames further apart are an interruption (docs/contact.md)."""


LOST_S = 2.0
"""The frames of 0.8 s wait; of so many more than 5 % of all between two reports are dropped (docs/operations.md)."""


@dataclass(frozen=True)
class Seen:
    """A press as the station reports it when it is recorded. Times are of the clock that nobody sets."""

    press_id: str
    noted_ns: int
    frame_ns: int | None
    """Of the judged frame, or of the rest that it stands for; None without one."""
    word: str
    judged_ns: int
    is_over_gap: bool
    """Frames are missing between the judged frame and the verdict."""
    after_gap_s: float
    """From the last interruption to the verdict."""
    came_ns: int
    """Of the judged frame, or of the one that has decided the press without one."""
    shown: str
    """What outputs may show of it: its word, but of a piece a pass only when all of it has passed; nothing of a master
    piece."""


@dataclass(frozen=True)
class Asked:
    """A snapshot that a person has asked for: its folder, when, of how many seconds, and in which life."""

    folder: str
    at_ns: int
    seconds: float
    life: int


class Station:
    """One station over all of its lives."""

    def __init__(
        self, world: World, folder: Path, begin: Callable[[], Config], read_again: Callable[[], Config]
    ) -> None:
        self.world, self.disk = world, Disk(folder)
        self.lives = 0
        self.seen: list[Seen] = []
        self.judged_ns: dict[str, int] = {}
        self.came_ns: dict[str, int] = {}
        self.began_ns = 0
        self.ended_ns: list[int] = []
        self.killed_ns: list[int] = []
        self.fed_ns: list[int] = []
        """The times of the frames that this life has looked at."""
        self.snapshots: list[Asked] = []
        self.complete = set[str]()
        """The names of those that were there, and complete, as last looked at."""
        self.disk_faults = 0
        """Times in which the disk failed, begun and ended."""
        self.reached = set[str]()
        """Conditions that auditors have seen."""
        self.answers: list[dict[str, Any]] = []
        """Of requests that people have sent, in order."""
        self.was_waiting = self.has_selected_late = False
        """The last life ended while a selection waited."""
        self.is_frozen = False
        """No thread of it gets a turn."""
        self.is_hanging = False
        """Its loop gets none, and other threads do."""
        self.hangs_in: str | None = None
        """`a turn`, `a verdict` or `a commit`: where the loop hangs next."""
        self.on_hang: Callable[[], object] = lambda: None
        """Called when it does."""
        self.hung: list[tuple[int, int]] = []
        """From when to when it hung."""
        self.lost_frames_ns = 0
        """When it went on after more frames than can wait, and no alarm has said so yet; 0 for never in this life."""
        self.raised_ns: dict[str, int] = {}
        """When an auditor has seen each alarm last."""
        self.off_bundle: Bundle | None = None
        """Of which golden frames score otherwise now."""
        self.told: list[tuple[int, str]] = []
        """The bundle that `info` named, and from when on."""
        self.fps = S / world.sensor.period_ns
        self.halted_ns: list[int] = []
        """When it was not ready, about each time that the camera makes a frame."""
        self.acts_before: int | None = None
        """Of times without sight, when the last one was long; None where that is one of them."""
        self._since: dict[str, tuple[object, int]] = {}
        self._mounted: tuple[int, tuple[str, int, int, str | None]] = 0, ("", 0, 1, None)
        self.found: list[str] = []
        """What must not be, and was seen on the way."""
        self.signed = set[str]()
        """Transactions that were signed with the station's secret."""
        self.heard: dict[str, bool] = {}
        """Transactions, and whether the station was connected when one of their requests was sent."""
        self.asking: list[threading.Thread] = []
        self.lost_rows: list[Row] = []
        """Of databases that were removed."""
        self.lost_masters: list[str] = []
        """And the gels of presses of the master piece."""
        self.is_loss_open = False
        """Presses, or the database, were lost, and nobody has acknowledged it."""
        self.dropped: Mapping[str, int] = {}
        """Messages that the station says it has dropped, by what they were; of databases before `dropped_before`."""
        self.dropped_before = Counter[str]()
        self.is_drop_open = False
        """Messages were dropped from a full outbox, and nobody has acknowledged it."""
        self.waiting: dict[int, tuple[str, str]] = {}
        """Rows of the outbox as last looked at: what each is (`picture`, `pass`, `fail`), and its press."""
        self.filled: dict[str, dict[str, tuple[str, str]]] = {}
        """The word and the press of each place of a piece, as the database that is there knows it."""
        self.archive_ns = 0
        """When objects of the archive came or went last, as last looked at."""
        self.late_ns: list[int] = []
        """When the alarm `pulse` counted a pulse more that was not given."""
        self.switch_turns_ns: list[int] = []
        """When the owner of the relay had taken a turn."""
        self._said_late: tuple[str, str] | None = None
        """The alarm `pulse` as last looked at."""
        self.has_lost_pieces = False
        """A database was removed, so an id may be used again."""
        self._asked = 0
        self._read_config, self._read_again = begin, read_again
        self._trunks = TrunkSessions(1)
        self._closing = ExitStack()
        self.loop: StationLoop
        world.is_dead = lambda: self.disk.is_dead
        world.may_refuse = lambda: self.is_disk_disturbed or self.is_hanging
        world.connections.answer, self.shared = self.answer, SharedDatabase(world.connections)
        hear_audits(self.disk)

    def open(self) -> None:
        """Begin a life."""
        self.lives += 1
        self.is_hanging = False
        self.fed_ns.clear()
        self._since.clear()
        self.lost_frames_ns = 0
        self.acts_before = None
        clock = self.world.clock
        self.began_ns = clock.now_ns
        if self.was_waiting or self.world.has_plc:
            self.world.parts.forget(clock.now_ns)
        self.world.gels.forget(clock.now_ns)
        self.config = self._read_config()
        checked = Preflight(BundleOpener(None, 1, clock))
        checked.opener.trunks = (
            self._trunks
        )  # the same file in each life: opening it again would find nothing
        config = self.config
        checked.opener.newest = lambda part: _describe_store(config, partial(revision, part=part))
        checked.opener.taken = lambda part: _describe_store(config, partial(read_takeover, part=part))
        checked.open_bundles(self.config)
        for finding in checked.findings:  # as `gelgate run`
            if finding.error is not None:
                raise finding.error
        if self.world.shelf.wrong:
            self.found.append(
                f"the gateway starts with a bundle that is {[*self.world.shelf.wrong.values()]}"
            )
        self.world.shelf.note_asked()
        witness = {"witness": Witness(self)}
        opened = open_station(self.config, clock, self._note, checked, self._read_again, witness)
        self.loop = self._closing.enter_context(opened)
        self.shared.begin(self)
        self.loop.parts.pictures.recall()
        if handshake := self.loop.find(HandshakeStage):
            handshake.start()

    @property
    def outputs(self) -> Outputs:
        """The stage with relay and pedal."""
        outputs = self.loop.find(Outputs)
        assert outputs is not None
        return outputs

    @property
    def is_calm(self) -> bool:
        """Everything has left, every broker retains `ready`, and no alarm is raised that ends by itself."""
        parts = self.loop.parts
        states = (json.loads(one.retained.get("state", b"{}")) for one in self.world.brokers.values())
        return (
            all(state.get("state") == "ready" for state in states)
            and not parts.publisher.outbox_status().rows
            and not (find_lasting(self) or self.is_drop_unsaid)
        )

    @property
    def is_drop_unsaid(self) -> bool:
        """Messages were dropped from a full outbox, and no alarm says so yet."""
        return self.is_drop_open and "outbox_full" not in self.loop.parts.status.view().alarms

    @property
    def is_disk_disturbed(self) -> bool:
        """No room, or errors."""
        is_refusing = self.disk.is_full or self.disk.locker.is_refusing
        return is_refusing or (self.disk.unsynced is not None and self.disk.unsynced.fails is not None)

    @property
    def is_held_up(self) -> bool:
        """It gets no time, or each flush of the disk takes its own."""
        return not self.is_between_turns or self.is_disk_slow

    @property
    def is_kept_from_it(self) -> bool:
        """It gets no time, or may record nothing."""
        is_refused = self.is_disk_disturbed or self.loop.is_halted or self.loop.session is None
        return self.is_held_up or is_refused

    @property
    def is_between_turns(self) -> bool:
        """Its loop can do what a person asks for: it waits for nothing in the middle of a turn."""
        is_stopped = self.is_frozen or self.is_hanging
        return not (is_stopped or self.world.connections.turns["loop"].is_waiting)

    @property
    def is_disk_slow(self) -> bool:
        """Each flush takes its time. In this world every thread waits for it, and not one alone."""
        return self.disk.unsynced is not None and self.disk.unsynced.at_sync is not None

    def so_since(self, name: str, is_so: bool, of: object = None) -> int | None:
        """Since when something is so in this life, without a change of what it is so of; None where it is not."""
        if not is_so or self._since.get(name, (of,))[0] != of:
            self._since.pop(name, None)
        return self._since.setdefault(name, (of, self.world.clock.now_ns))[1] if is_so else None

    def watch_late(self) -> None:
        """Note the pulses that the alarm `pulse` counts since the last look, which is after each turn of an actor."""
        before, said = self._said_late, self.loop.parts.status._raised.get("pulse")
        if said is not None and said is not before:
            count, counted = int(said[0].split()[0]), int(before[0].split()[0]) if before else 0
            more = count - counted if count > counted else count  # a person has acknowledged it meanwhile
            self.late_ns += [self.world.clock.now_ns] * more
        self._said_late = said

    def stop(self) -> None:
        """End in order, as at SIGTERM."""
        self._note_end()
        sinks = self.world.connections.sinks
        brokers = [one for one in self.world.brokers.values() if one.mood == "up" and one.is_connected]
        connected = [one for one in brokers if sinks[one.name].level]
        unheard = {name for name in sinks if self.world.connections.turns[name].is_waiting}
        stop = threading.Event()
        stop.set()
        try:
            self.loop.turn_until(stop)
        except (
            StoreError
        ) as error:  # the program ends with it; presses that wait are counted at the next start
            self.world.said.append(str(error))
        self.world.connections.settle("pictures")
        self.hear_answers()
        self._closing.close()
        self.world.connections.end_turns()
        self.world.connections.pump()
        for broker in connected:
            state = json.loads(broker.retained["state"])["state"]
            may_be_lost = self.is_disk_slow or broker.name in unheard  # then the broker publishes its will
            if state not in ("stopped", "lost" if may_be_lost else "") and not self.disk.is_dead:
                self.found.append(f"{broker.name} retains {state} of a station that ended in order")
        self.disk.forget()

    def hang(self, where: str) -> None:
        """Do not go on here for a while, where a fault wants that; the loop calls it, in a turn of its own."""
        if self.hangs_in == where and not self.disk.is_dead and self.world.connections.can_wait:
            self.hangs_in, began_ns, given = None, self.world.clock.now_ns, self.world.sensor.given
            self.on_hang()
            self.world.connections.wait(lambda: not self.is_hanging, 3600, poll_s=0.05)
            self.hung.append((began_ns, self.world.clock.now_ns))
            is_said = self.raised_ns.get("overload", 0) >= self.lost_frames_ns
            if is_said and self.world.sensor.given - given > LOST_S * self.fps:
                self.lost_frames_ns = self.world.clock.now_ns

    def _note_end(self) -> None:
        self.ended_ns.append(self.world.clock.now_ns)
        # A process that is killed while it records a selection that waited does not know any more that it did.
        is_unsure = self.disk.is_dead and self.has_selected_late
        self.was_waiting = self.loop.parts.selection.is_waiting or is_unsure

    def lose_database(self) -> None:
        """Remove the database: what it knows is known to auditors alone. The next life must say that it is lost."""
        path = self.disk.folder / "gelgate.db"
        self.world.pieces.forget(self.world.clock.now_ns)
        self.lost_rows += self.rows()[len(self.lost_rows) :]
        self.lost_masters += self.master_gels()[len(self.lost_masters) :]
        self.filled.clear()
        self.has_lost_pieces = True
        self.is_loss_open = bool(self.lost_rows)
        self.dropped_before += Counter(self.dropped)
        self.dropped, self.is_drop_open = {}, False
        for name in (path, path.with_name(f"{path.name}-wal"), path.with_name(f"{path.name}-shm")):
            name.unlink(missing_ok=True)

    def rows(self) -> list[Row]:
        """Id, verdict, part and gel of each row that there ever was, in order."""
        # There is no table where the power was cut and nothing of the file was synced.
        is_there = self.disk.read("SELECT 1 FROM sqlite_master WHERE name = 'presses'")
        query = "SELECT press_id, verdict, part, gel_id FROM presses WHERE serial = ? ORDER BY number"
        return [*self.lost_rows, *(self.disk.read(query, SERIAL) if is_there else ())]

    def mounted_gel(self) -> tuple[str, int, int, str | None]:
        """Id, presses, limit and last day of use of the gel that is mounted; read once for each moment."""
        query = (
            "SELECT gel_id, presses, limit_presses, use_by FROM gels WHERE serial = ? AND removed_ns IS NULL"
        )
        if self._mounted[0] != self.world.clock.now_ns:
            self._mounted = self.world.clock.now_ns, self.disk.read(query, SERIAL)[0]
        return self._mounted[1]

    def master_gels(self) -> list[str]:
        """The gel of each press of the master piece that there ever was."""
        is_there = self.disk.read("SELECT 1 FROM sqlite_master WHERE name = 'reference_presses'")
        query = "SELECT gel_id FROM reference_presses ORDER BY number"
        return [*self.lost_masters, *(gel for (gel,) in (self.disk.read(query) if is_there else ()))]

    def count_openings(self) -> int:
        """Count the times that bundles were opened again, as the acts have them."""
        return int(self.disk.read("SELECT count(*) FROM acts WHERE verb = 'open_bundles'")[0][0])

    def bury(self) -> None:
        """The process is dead: its folder is as it was at that point."""
        copy = self.disk.copy
        assert copy is not None
        self._note_end()
        self.killed_ns.append(self.world.clock.now_ns)
        self.world.connections.end_turns()
        self.loop.parts.calls.close(self.loop)
        self.loop.parts.selection.golden.close()
        self.hear_answers()
        self._closing.close()
        self.disk.forget()
        hear_audits(None)
        kind = self.disk.locker.kind
        self.disk.locker.leave()
        shutil.rmtree(self.disk.folder)
        copy.rename(self.disk.folder)
        if kind:
            self.disk.locker.take(kind)
        known = {press_id for press_id, *_ in self.rows()} if self.filled else set()
        self.filled = {
            piece: {place: one for place, one in places.items() if one[1] in known}
            for piece, places in self.filled.items()
        }
        if self.disk.unsynced is not None:
            self.disk.unsynced.start_again()
        hear_audits(self.disk)

    def close(self) -> None:
        """End the run."""
        self.world.connections.end_turns()
        if hasattr(self, "loop"):
            self.loop.parts.calls.close(self.loop)
            self.loop.parts.selection.golden.close()
            self.hear_answers()
        self._closing.close()
        hear_audits(None)

    def ask(self, verb: str, **arguments: Any) -> Any:
        """Do a request as the loop does it."""
        command = next(command for command in every_command() if command.verb == verb)
        return command.do(self.loop, command.arguments.of(arguments))

    def send_request(
        self,
        verb: str,
        arguments: dict[str, Any],
        secret: str | None,
        transaction: str | None = None,
        *,
        elsewhere: bool = False,
    ) -> str:
        """Send a request over MQTT. elsewhere: it wants its answer where none may go. Returns the transaction."""
        self._asked += 1
        transaction, time_ns = transaction or f"request {self._asked}", self.world.clock.time_ns()
        content: dict[str, Any] = {"transaction": transaction, "arguments": arguments, "by": "a person"}
        if secret is not None:
            root = self.config.station.place.root
            text = signed_text(root, verb, transaction, time_ns, "a person", arguments)
            content |= {"time_ns": time_ns, "signature": signature_of(secret.encode(), text)}
        if secret == SECRET:
            self.signed.add(transaction)
        broker = next(iter(self.world.brokers.values()))
        topic = f"{broker.root}/state" if elsewhere else None
        is_heard = broker.ask(verb, json.dumps(content).encode(), topic)
        self.heard[transaction] = is_heard or self.heard.get(transaction, False)
        return transaction

    def answer(self, do: Callable[[str, bytes], bytes], verb: str, payload: bytes) -> bytes:
        """Do a request that a sink has received, on a thread of its own; the loop answers with its next turn.

        Only one of the two threads runs at a time: the loop's turn goes on when the request is done.
        """
        calls, golden, found = self.loop.parts.calls, self.loop.parts.selection.golden, list[bytes]()
        waiting = len(calls._waiting)
        calls._answer_s = 3600.0  # of real time, which says nothing here

        def answer() -> None:
            found.append(do(verb, payload))
            self.answers.append(json.loads(found[0]))

        thread = threading.Thread(target=answer)
        thread.start()
        while thread.is_alive() and len(calls._waiting) == waiting:
            time.sleep(0)
        if len(calls._waiting) > waiting:
            came_ns, ask = calls._waiting.pop()

            def ask_and_wait(loop: StationLoop) -> None:
                scored = len(golden._asked)
                ask(loop)
                if len(golden._asked) > scored:  # it waits for the frames, which the loop scores later
                    golden._asked[-1].add_done_callback(lambda _: self._let_go_on(thread))
                else:
                    self._let_go_on(thread)

            calls._waiting.append((came_ns, ask_and_wait))
        self.asking.append(thread)
        self.world.connections.wait(lambda: bool(found), 3600, poll_s=0.05)
        return found[0] if found else b"{}"

    def _let_go_on(self, thread: threading.Thread) -> None:
        # In a process that ends it may be the thread itself that asks.
        is_its_own = thread is threading.current_thread()
        if not (is_its_own or self.shared.is_store_held):  # which it may wait for
            thread.join()

    def allows(self, answer: dict[str, Any]) -> bool:
        """Tell whether this request may be done: it was signed with the station's secret, or everyone may ask it."""
        return answer["transaction"] in self.signed or answer["verb"] in self.config.commands.unsigned

    def hear_answers(self) -> None:
        """Wait for the threads whose requests the loop has done, with the golden frames that one may have asked for."""
        golden = self.loop.parts.selection.golden._asked
        if self.shared.is_store_held:  # which they may wait for
            return
        if not self.loop.parts.calls._waiting and all(asked.done() for asked in golden):
            for thread in self.asking:
                thread.join()
            self.asking.clear()

    def _note(self, report: PressReport) -> None:
        """Note what was seen of a press, also by a dead process that has written before."""
        press, now_ns = report.press, self.world.clock.now_ns
        judged_ns, frame_ns = self.judged_ns[press.press_id], press.judged_ns or now_ns
        gaps = [(then, later) for then, later in pairwise(self.fed_ns[-200:]) if later - then > GAP_NS]
        is_over = any(later >= frame_ns and then + GAP_NS <= judged_ns for then, later in gaps)
        ended_ns = max((later for _, later in gaps if later <= judged_ns), default=0)
        after_s = (now_ns - ended_ns) / S
        self.seen.append(
            Seen(
                *(press.press_id, now_ns, press.judged_ns, press.word),
                *(judged_ns, is_over, after_s),
                *(self.came_ns[press.press_id], self._show(report)),
            )
        )
        self.hang("a commit")

    def _show(self, report: PressReport) -> str:
        """Say what outputs may show of a press, after docs/operations.md."""
        word, piece, place = report.press.word, report.result.piece_id, report.result.place
        if report.press.label is not None:
            return ""
        if piece is None:
            return word
        filled = self.filled.setdefault(piece, {})
        if place is not None and word in ("pass", "fail"):
            filled.setdefault(place, (word, report.press.press_id))
        if word != "pass":
            return word
        is_failed = any(word == "fail" for word, _ in filled.values())
        return "fail" if is_failed else "pass" if len(filled) == len(PARTS) else ""


class Witness(PressStage):
    """Notes when presses are judged; closes when the station has said its last word, and lets it out, as its threads
    would."""

    def __init__(self, station: Station) -> None:
        self._station = station

    def judge(self, press: Press, settled: PressSettled | None, inspector: Inspector) -> Press:
        station = self._station
        station.judged_ns[press.press_id] = station.world.clock.now_ns
        station.came_ns[press.press_id] = press.judged_ns or station.fed_ns[-1]
        station.hang("a verdict")
        return press

    def close(self) -> None:
        self._station.world.connections.drain()


STAYS = {
    "archive",
    "drift",
    "outbox_full",
    "counts",
    "pulse",
    "overload",
    "piece",
    "gel",
    "gel_expired",
    "gel_proof",
    "gel_mark",
    "disk",
    "reference",
    "escape",
    "false_alarms",
    "gel_scar",
    "press_again",
    "takeover",
}
"""Alarms that a person ends, or the next press, or that say what is not over."""


def find_lasting(station: Station) -> set[str]:
    """Find the alarms that are raised and end by themselves when all is well."""
    return set(station.loop.parts.status.view().alarms) - STAYS
