"""Pieces of three places at a station that is killed, whose database fails, and whose operator makes mistakes.

Real: the stages of pieces and of outputs, the recorder, the selection of bundles and the database. Scripted: what a
press scores, the contact and the loop, which calls them in the order of `StationLoop.step`. What the operator did is
kept apart from the station, and compared with what the station said at the end.
"""

import json
import random
import sqlite3
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final
from unittest.mock import ANY, Mock

from tiny import tiny_files

from edge.clock import ManualClock
from edge.config import Config
from edge.core.contact.events import PressBegan
from edge.core.digital_io import StationView
from edge.core.errors import StoreError
from edge.core.imaging.quality import Reason, Rejection
from edge.core.overview.view import OverviewView
from edge.core.part_position import PartPosition
from edge.core.ports import Message
from edge.core.press import Press
from edge.core.sink_context import Place
from edge.core.verdict import decide
from edge.features.outputs.stage import Outputs
from edge.features.piece import Pieces
from edge.gateway.bundle_set import BundleSet, OpenBundle
from edge.gateway.part_selection import PartSelection
from edge.gateway.recorder import Recorder, WaitingPress
from edge.gateway.status import StationStatus
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.press_stage import Mounted, PressStage, StageParts
from edge.store.bundles_in_use import read_selected
from edge.store.integrity import check_database
from edge.store.press_store import Store
from edge.store.ulid import new_ulid

PLACES: Final = tuple(PartPosition("bolt", name) for name in ("left", "middle", "right"))
SERIAL: Final = "S1"
WITHIN_S: Final = 600.0
WORDS: Final = {"pass": 0.85, "fail": 0.06, "unsure": 0.04, "rejected": 0.03, "error": 0.02}
NEVER: Final = (
    "passed with a place missing",
    "lost",
    "doubled",
    "another verdict than its presses",
    "faults of the database",
)
"""What must not be, by its name in `World.audit`."""

WRITES: Final = ("INSERT", "UPDATE", "DELETE", "COMMIT")


class Killed(BaseException):
    """The process is gone: nothing after this is executed."""


@dataclass
class Faults:
    """What becomes of the next writes: `kind` strikes at the one of this number, and an error stays for some more."""

    kind: str = ""
    after: int = 0
    lasts: int = 0
    struck: Counter[str] = field(default_factory=Counter)

    def plan(self, rng: random.Random) -> None:
        self.kind = rng.choice(
            ("killed before", "killed after", "refused", "committed and reported as failed")
        )
        self.after, self.lasts = rng.randrange(30), rng.randrange(1, 25)

    def execute(self, sql: str, do: Callable[[], Any]) -> Any:
        words = WRITES if self.kind[:6] != "commit" else ("COMMIT",)
        if not self.kind or not sql.lstrip().upper().startswith(words):
            return do()
        self.after -= 1
        if self.after >= 0:
            return do()
        self.struck[self.kind] += self.after == -1
        if self.kind == "killed before":
            raise Killed
        if self.kind == "refused":
            self.lasts -= 1
            self.kind = self.kind if self.lasts else ""
            raise sqlite3.OperationalError("disk I/O error")
        kind, self.kind = self.kind, ""
        done = do()
        if kind == "killed after":
            raise Killed
        raise sqlite3.OperationalError(f"disk I/O error after {done.rowcount}")


@contextmanager
def faulty(faults: Faults) -> Iterator[None]:
    """Inside, every database that is opened fails as planned."""

    class Connection(sqlite3.Connection):
        def execute(self, sql: str, *arguments: Any) -> Any:
            return faults.execute(sql, partial(super().execute, sql, *arguments))

        def executemany(self, sql: str, *arguments: Any) -> Any:
            return faults.execute(sql, partial(super().executemany, sql, *arguments))

    connect = sqlite3.connect
    sqlite3.connect = partial(connect, factory=Connection)  # type: ignore[assignment]
    try:
        yield
    finally:
        sqlite3.connect = connect


def make_bundles(clock: ManualClock) -> BundleSet:
    """A bundle for each place; they share everything but the name."""
    bundles = BundleSet()
    for place in PLACES:
        bundle = Bundle.in_memory(*tiny_files(part=place.part, position=place.position))
        one = OpenBundle(Path(place.position), (), Inspector(Scorer(bundle, 1), clock), 0.0)
        bundles = bundles.with_one(one)
    return bundles


class Relay:
    """What the outputs show."""

    def __init__(self, check: Callable[[str], None]) -> None:
        self._check = check
        self.verdict: str | None = None

    def show(self, view: StationView) -> None:
        self.verdict = view.verdict if view.state == "ready" else None
        if self.verdict == "pass":
            self._check("shown")

    def pulse(self, word: str, judged_ns: int) -> None:
        if word == "pass":
            self._check("given as a pulse")


class Life:
    """One start of the station, until it is killed."""

    def __init__(
        self, path: Path, clock: ManualClock, bundles: BundleSet, order: str, told: set[str]
    ) -> None:
        self.clock, self.said, self._told = clock, dict[str, Any](), told
        self.is_pressed = False
        self.waiting: deque[WaitingPress] = deque()
        self.store = Store(path, monotonic_ns=clock.monotonic_ns)
        self.gel = self.store.gel(SERIAL, clock.time_ns())
        self.status = StationStatus(self._hear, clock)
        part = self.store.read("reading the selected part", read_selected) or PLACES[0]
        self.selection = PartSelection(bundles, part, Mock(), self.store, self.status, clock)
        parts = StageParts(
            make_config(path, order), clock, self.store, self.status, self.selection,
            find_sensor=Mock(), find_low_space=Mock(), post=Mock(), trigger=Mock(), do=Mock(),
            announce=self.status.announce, listen=Mock(),
        )  # fmt: skip
        opened = Pieces.open(parts)
        assert opened is not None
        self.pieces, self.outputs = opened, Outputs(lambda alarm, text: None, clock)
        self.relay = Relay(self._check_pass)
        self.outputs.drivers = [self.relay]  # type: ignore[list-item]
        self.stages: list[PressStage] = [self.pieces, self.outputs]
        place = Place("plant", "line1", "station1")
        self.recorder = Recorder(self.store, SERIAL, place, clock, lambda drawing: None, self.stages)

    def _hear(self, message: Message) -> None:
        if message.payload.startswith(b"{"):
            self.said[message.topic] = content = json.loads(message.payload)
            if message.topic == "piece" and content["piece_id"] is not None:
                self._told.add(content["piece_id"])
        else:
            self.said.pop(message.topic, None)

    def _check_pass(self, how: str) -> None:
        """No pass without a piece in the database that has passed, and none while another one is in progress."""
        query = "SELECT verdict FROM pieces ORDER BY number DESC LIMIT 1"
        newest = self.store.read("looking", lambda it: it.execute(query).fetchone())
        assert newest == ("pass",), f"a pass was {how}, and the newest piece is {newest}"

    def turn(self) -> None:
        """As `StationLoop.step`, without a frame."""
        try:
            self.selection.step(is_pressed=self.is_pressed)
            digest = self.selection.inspector.bundle.digest
            mounted = Mounted(SERIAL, self.gel.gel_id, self.selection.part, digest, self.is_pressed)
            for stage in self.stages:
                stage.turn(mounted)
            self.record()
            self.status.clear_fault("store")
        except StoreError as error:
            self.status.set_fault("store", str(error))
        view = self.status.view()
        for stage in self.stages:
            stage.show(view)

    def record(self) -> None:
        while self.waiting:
            report = self.recorder.record(self.waiting[0])
            self.waiting.popleft()
            self.gel = report.gel
            for stage in self.stages:
                stage.record(report.press, report.gel)

    def press(self, word: str, codes: tuple[str, ...], turns: int, note: Callable[[str], None]) -> Press:
        """Press, hold for so many turns, and lift; return the press as it was judged. note: takes its id."""
        self.is_pressed = True
        inspector, time_ns = self.selection.inspector, self.clock.time_ns()
        for stage in self.stages:
            stage.see(PressBegan(0, 0))
        self.turn()
        press = Press(press_id=new_ulid(time_ns), time_ns=time_ns, bundle_id=inspector.bundle.digest)
        note(press.press_id)
        press = replace(press, overview=OverviewView(b"jpeg", piece_ids=codes) if codes else None)
        for stage in self.stages:
            press = stage.admit(press)
        press = score(press, word)
        for stage in self.stages:
            press = stage.judge(press, None, ANY)
        self.waiting.append(self.recorder.prepare(press, inspector))
        for _ in range(turns):
            self.clock.sleep(0.05)
            self.turn()
        self.is_pressed = False
        self.turn()
        return press

    def close(self) -> None:
        self.selection.close()
        self.store.close()


def score(press: Press, word: str) -> Press:
    if press.is_decided:
        return press
    if word == "error":
        return replace(press, error="it could not be scored")
    if word == "rejected":
        return press.reject(Rejection(Reason.OFF_POSITION, "it lay elsewhere"))
    number = {"pass": 0.0, "unsure": 1.0, "fail": 2.0}[word]
    return replace(press, verdict=decide(number, 1.0, 0.1), judged_ns=1)


def make_config(path: Path, order: str) -> Config:
    places = [place._asdict() for place in PLACES]
    return Config.model_validate(
        {
            "version": 1,
            "device": {"plugin": "usb_mock"},
            "inspection": {"bundle_folder": str(path.parent)},
            "sinks": [{"plugin": "memory"}],
            "piece": {"places": places, "order": order, "within_s": WITHIN_S},
        }
    )


@dataclass(frozen=True)
class Performed:
    """A press that the operator made."""

    piece: int
    """Which physical piece."""
    place: PartPosition
    word: str


class World:
    """The operator with his pieces; `play` makes so many, and `audit` compares."""

    def __init__(self, path: Path, seed: int, order: str) -> None:
        self.rng, self.clock = random.Random(seed), ManualClock()
        self.clock.sleep(1_700_000_000)
        self.faults, self.counts = Faults(), Counter[str]()
        self._path, self._order, self._bundles = path, order, make_bundles(self.clock)
        self.performed: dict[str, Performed] = {}
        self.given: dict[str, int] = {}
        """The id of a piece to the physical piece for which it was given."""
        self.told: set[str] = set()
        """Every piece of which the station has said that it is in progress."""
        self.needs_id = False
        self.life = Life(path, self.clock, self._bundles, order, self.told)

    def play(self, pieces: int) -> None:
        try:
            with faulty(self.faults):
                self.restart()
                for number in range(pieces):
                    self.run_piece(number)
                self.faults.kind = ""
                self.begin("the last one", pieces)
        finally:
            self.life.close()

    def restart(self) -> None:
        self.life.close()
        self.faults.kind = ""
        self.clock.sleep(self.rng.uniform(1, 60))
        self.life = Life(self._path, self.clock, self._bundles, self._order, self.told)

    def survive(self, do: Callable[[], Any]) -> Any:
        """Do it; a kill on the way is a restart, and None."""
        if not self.faults.kind and self.rng.random() < 0.25:
            self.faults.plan(self.rng)
        try:
            return do()
        except Killed:
            self.counts["kills"] += 1
            self.restart()
            return None

    def run_piece(self, number: int) -> None:
        """Press all its places, unless it is left, or the station says that it is over."""
        mode = self.rng.choices(("request", "code", "none"), (60, 20, 20))[0]
        if mode == "none" and self.needs_id:
            mode = "request"
        piece_id = None if mode == "none" else f"P{number:05d}"
        self.needs_id = False
        if piece_id is not None:
            self.given[piece_id] = number
        if mode == "request":
            self.begin(str(piece_id), number)
        leaves_after = self.rng.randrange(4) if self.rng.random() < 0.15 else 99
        before = self.life.said["piece"]["last_id"]
        for presses in range(1000):
            said = self.life.said["piece"]
            if presses and said["piece_id"] is None and said["last_id"] not in (None, before):
                self.counts["ended"] += 1
                return
            if presses >= leaves_after:
                self.leave(number)
                return
            self.press(number, (piece_id,) if mode == "code" and piece_id else ())
        raise AssertionError(f"piece {number} never ends: {self.life.said}")

    def begin(self, piece_id: str, number: int) -> None:
        """Ask until it has begun: an answer may be lost with the process."""
        self.given[piece_id] = number
        for _ in range(200):
            if self.life.said["piece"]["piece_id"] == piece_id:
                return
            self.survive(partial(self._ask, piece_id))
            self.life.turn() if not self.faults.kind else self.survive(self.life.turn)
        raise AssertionError(f"{piece_id} does not begin: {self.life.said}")

    def _ask(self, piece_id: str) -> None:
        try:
            self.life.pieces.begin_piece(piece_id)
        except StoreError:
            self.counts["begins that failed"] += 1
        except ValueError as error:
            self._check_refusal(str(error))

    def _check_refusal(self, sentence: str) -> None:
        """What the station knows of the contact is that of its last turn without a fault."""
        known = ("waits to be recorded", "in progress", "something presses")
        assert any(words in sentence for words in known), sentence

    def leave(self, number: int) -> None:
        """Take it away: the next one has an id. Some operators wait, and try without."""
        self.needs_id = True
        if self.rng.random() < 0.5:
            self.counts["left"] += 1
            return
        self.counts["timed out"] += 1
        is_open = self.life.said["piece"]["piece_id"] is not None
        self.clock.sleep(WITHIN_S + 1)
        for _ in range(60):
            self.survive(self.life.turn)
            if self.life.said["piece"]["piece_id"] is None:
                break
        assert self.life.said["piece"]["piece_id"] is None, "it is not over"
        if is_open:
            press = self.press(number + 10**6, ())
            assert press is None or press.word == "rejected", (
                "the rest of a piece that was left takes a press"
            )

    def press(self, number: int, codes: tuple[str, ...]) -> Press | None:
        """Choose a place, mostly the right one, and press it; before it something may happen."""
        self.disturb()
        place = PartPosition(*self.rng.choice(self.life.said["piece"]["expected"]).split("/"))
        if self.rng.random() < 0.06:
            place = self.rng.choice(PLACES)
            self.counts["other places"] += 1
        if place != self.life.selection.part:
            self.survive(partial(self._select, place))
        word = self.rng.choices(list(WORDS), list(WORDS.values()))[0]
        place = self.life.selection.part
        press = self.survive(partial(self._do, number, place, word, codes))
        self.clock.sleep(self.rng.uniform(0.5, 5))
        for _ in range(40):
            if not self.life.waiting:
                break
            self.survive(self.life.turn)
        return press if isinstance(press, Press) else None

    def _do(self, number: int, place: PartPosition, word: str, codes: tuple[str, ...]) -> Press:
        def note(press_id: str) -> None:
            self.performed[press_id] = Performed(number, place, word)
            self.counts["presses"] += 1

        return self.life.press(word, codes, self.rng.randrange(1, 4), note)

    def _select(self, place: PartPosition) -> None:
        try:
            self.life.selection.select(place, is_pressed=False)
        except StoreError:
            self.counts["selections that failed"] += 1

    def disturb(self) -> None:
        chance = self.rng.random()
        if chance < 0.02:
            self.counts["gels"] += 1
            self.survive(self._replace_gel)
        elif chance < 0.06 and self.given:
            self.counts["ids twice"] += 1
            before = self.life.said["piece"]
            self.survive(partial(self._ask_twice, self.rng.choice(list(self.given))))
            assert self.life.said["piece"]["piece_id"] == before["piece_id"]

    def _ask_twice(self, piece_id: str) -> None:
        known = self.life.store.read(
            "looking",
            lambda it: it.execute("SELECT 1 FROM pieces WHERE piece_id = ?", (piece_id,)).fetchone(),
        )
        if known is None:
            return
        try:
            self.life.pieces.begin_piece(piece_id)
        except (ValueError, StoreError):
            return
        raise AssertionError(f"{piece_id} began twice")

    def _replace_gel(self) -> None:
        try:
            self.life.gel = self.life.store.replace_gel(SERIAL, self.clock.time_ns())
        except StoreError:
            self.counts["gels that failed"] += 1

    def audit(self) -> Counter[str]:
        """Compare what was said with what was done; return the counts."""
        with sqlite3.connect(self._path) as connection:
            query = "SELECT payload FROM outbox WHERE topic = 'piece_result' ORDER BY row_id"
            results = [json.loads(payload) for (payload,) in connection.execute(query)]
            rows = dict(connection.execute("SELECT piece_id, verdict FROM pieces"))
            failed = {
                piece_id
                for (piece_id,) in connection.execute(
                    "SELECT piece_id FROM presses WHERE verdict = 'fail' AND piece_id IS NOT NULL"
                )
            }
        connection.close()
        ids = Counter(result["piece_id"] for result in results)
        over = {piece_id: verdict for piece_id, verdict in rows.items() if verdict is not None}
        self.counts["doubled"] = sum(number > 1 for number in ids.values())
        self.counts["lost"] = len(over.keys() - ids.keys()) + len(self.told - rows.keys())
        self.counts["passed with a place missing"] = sum(
            not self._has_passed(result) for result in results if result["verdict"] == "pass"
        )
        self.counts["another verdict than its presses"] = sum(
            (result["verdict"] == "fail") != (result["piece_id"] in failed)
            or result["verdict"] != over[result["piece_id"]]
            for result in results
        )
        self.counts["faults of the database"] = sum(one.is_fault for one in check_database(self._path))
        self.counts.update(f"verdict {result['verdict']}" for result in results)
        self.counts.update(self.faults.struck)
        return self.counts

    def _has_passed(self, result: dict[str, Any]) -> bool:
        """Every place by a press that passed, at this place, of one physical piece: that which has the id."""
        pieces = set()
        for place in result["places"]:
            done = self.performed.get(place["press_id"] or "")
            if done is None or done.word != "pass" or done.place != (place["part"], place["position"]):
                return False
            pieces.add(done.piece)
        known = self.given.get(result["piece_id"])
        return len(result["places"]) == len(PLACES) and len(pieces) == 1 and known in (None, *pieces)
