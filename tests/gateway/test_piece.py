"""A piece of several places at a running station: begun, pressed, ended, and what outputs and messages say of it."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from station import Motion, mark_tried, press_recording, station_config, variant
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import ConfigError, StoreError
from edge.core.part_position import PartPosition
from edge.core.press import Press, PressLabel, ReferenceLabel, StudyLabel
from edge.features.outputs.stage import Outputs
from edge.features.overview import Overview
from edge.features.piece import Pieces
from edge.gateway.preflight import preflight
from edge.model.bundle import Bundle
from edge.press_stage import PressStage
from edge.store.acts import Act
from edge.store.history import HistoryQuery, read_history
from edge.store.integrity import check_database
from edge.store.press_store import PressRecord, Store
from edge.store.study_presses import StudyTable

NAMES = ("left", "middle", "right")
LEFT, MIDDLE, RIGHT = (PartPosition("PZ0", name) for name in NAMES)
BEGUN = 'unsigned = ["begin_piece", "select_part"]'
RELAYS = """
[[actuators]]
plugin = "virtual_hid"
options = { log = "switched.jsonl" }
outputs = [
  { channel = 1, when = ["pass"] },
  { channel = 2, when = ["fail"] },
  { channel = 3, when = ["fail"], pulse_ms = 200, deadline_ms = 60000 },
]
"""

Make = Callable[..., Path]


def plan(order: str = "fixed", names: tuple[str, ...] = NAMES, within_s: float = 3600) -> str:
    places = "".join(f'[[piece.places]]\npart = "PZ0"\nposition = "{name}"\n' for name in names)
    return f'[commands]\n{BEGUN}\n[piece]\norder = "{order}"\nwithin_s = {within_s}\n{places}'


@pytest.fixture
def configure(tmp_path: Path, bundle: Path) -> Make:
    """Write the configuration of a station with a bundle for each of three places."""

    def make(
        tables: str,
        presses: int = 3,
        dented: tuple[int, ...] = (),
        shadows: Sequence[Path] = (),
        **given: Any,
    ) -> Path:
        for name in NAMES:
            variant(bundle, tmp_path / "bundles" / name, position=name)
        folder = tmp_path / f"presses{len(list(tmp_path.iterdir()))}"
        recording = press_recording(folder, presses, dented=dented, motion=Motion(hold=8))
        inspection = f'bundle_folder = "{tmp_path / "bundles"}"\npart = "PZ0/left"'
        inspection += f"\nshadows = {[str(shadow) for shadow in shadows]}"
        config = station_config(tmp_path, recording, inspection, tables=tables, **given)
        mark_tried(tmp_path / "gelgate.db", *(tmp_path / "bundles" / name for name in NAMES), *shadows)
        return config

    return make


class PieceStation(SteppedStation):
    @property
    def words(self) -> list[tuple[str | None, str | None]]:
        """Place and verdict of each press."""
        return [(result.place, result.verdict) for result in self.results]

    def ended(self) -> list[dict[str, Any]]:
        """Every message of a piece that ended."""
        query = "SELECT payload FROM outbox WHERE topic = 'piece_result' ORDER BY row_id"
        rows = self.parts.store.read("reading", lambda it: it.execute(query).fetchall())
        return [json.loads(payload) for (payload,) in rows]

    def select(self, name: str) -> None:
        self.ask("select_part", part="PZ0", position=name)


def filled(message: dict[str, Any]) -> list[str | None]:
    return [place["verdict"] for place in message["places"]]


def test_a_piece_is_pressed_place_by_place_and_passes_when_all_came(configure: Make) -> None:
    """The bundle of the next place is selected by itself; the first press has begun the piece; history, results and
    ledger have its id."""
    with PieceStation(configure(plan())) as station:
        assert station.said("piece")["piece_id"] is None
        station.play_presses(2)
        said = station.said("piece")
        assert (filled(said), said["expected"]) == (["pass", "pass", None], ["PZ0/right"])
        assert station.ended() == []
        station.play()

        (ended,) = station.ended()
        results, path = station.results, station.parts.store.path
        acts = [act for act in station.parts.store.acts() if act.verb == "select_part"]
        assert station.said("piece")["last_verdict"] == "pass"
    assert station.words == [(str(place), "pass") for place in (LEFT, MIDDLE, RIGHT)]
    assert (ended["verdict"], ended["ended_by"], filled(ended)) == ("pass", "complete", ["pass"] * 3)
    assert [place["press_id"] for place in ended["places"]] == [one.press_id for one in results]
    assert {one.piece_id for one in results} == {ended["piece_id"]}
    assert {row.piece_id for row in read_history(path, HistoryQuery())} == {ended["piece_id"]}
    assert [act.who for act in acts] == ["the plan of the piece"] * 3
    assert check_database(path) == []


def test_relays_show_a_pass_of_the_whole_piece_and_a_fail_at_once(tmp_path: Path, configure: Make) -> None:
    """Two pieces: the first one passes at its last press; the second fails at its first, and at each after it."""
    lit: list[list[int]] = []
    with PieceStation(configure(plan() + RELAYS, presses=6, dented=(3,))) as station:
        while not station.has_ended:
            before = len(station.reports)
            station.play(1)
            (driver,) = station.find(Outputs).drivers
            driver.step()
            if len(station.reports) > before:
                log = [json.loads(line) for line in (tmp_path / "switched.jsonl").read_text().splitlines()]
                now = {line["channel"]: line["on"] for line in log}
                lit.append([channel for channel in (1, 2) if now[channel]])

    assert lit == [[], [], [1], [2], [2], [2]]


def test_a_pass_goes_off_when_the_next_piece_begins(configure: Make) -> None:
    """It was the pass of the piece before."""
    with PieceStation(configure(plan(names=("left",)) + RELAYS)) as station:
        station.play_presses(1)
        outputs = station.find(Outputs)
        assert outputs._verdict == "pass"
        station.ask("begin_piece")
        station.turn()
        assert outputs._verdict is None


def test_in_a_free_order_the_selected_part_is_the_place_and_the_last_one_is_selected(configure: Make) -> None:
    """A place that was pressed before counts no more."""
    with PieceStation(configure(plan("free"), presses=4)) as station:
        station.select("middle")
        station.play_presses(2)
        assert station.words == [("PZ0/middle", "pass"), (None, "rejected")]
        reason = station.results[1].reason
        station.select("right")
        station.play()
        (ended,) = station.ended()

    assert reason == (
        "no_place: PZ0/middle was pressed before (pass); select and press PZ0/left, PZ0/right of this piece, or begin "
        "the next piece"
    )
    assert station.words[2:] == [("PZ0/right", "pass"), ("PZ0/left", "pass")]
    assert ended["verdict"] == "pass"


@pytest.mark.parametrize(
    ("selected", "tables", "sentence"),
    [
        ("right", plan(), "PZ0/right comes later; select and press PZ0/left of this piece"),
        (
            "right",
            plan("free", ("left", "middle")),
            "PZ0/right is no place of the plan; select and press PZ0/left",
        ),
    ],
)
def test_a_press_at_another_place_is_refused_and_begins_nothing(
    configure: Make, selected: str, tables: str, sentence: str
) -> None:
    """With the place that is expected. In a fixed order that place is selected again."""
    with PieceStation(configure(tables)) as station:
        station.play_until(lambda: station.loop.session is not None)
        station.select(selected)
        station.play_presses(1)
        result = station.results[0]
        is_selected = station.parts.selection.part == LEFT

    assert (result.verdict, result.piece_id) == ("rejected", None)
    assert sentence in str(result.reason)
    assert is_selected == ("fixed" in tables)


def test_a_piece_that_takes_too_long_is_incomplete_and_a_person_begins_the_next(configure: Make) -> None:
    """What is left of it may still lie there: no press begins a piece until then."""
    with PieceStation(configure(plan(within_s=3.5), presses=5)) as station:
        station.play_presses(2)
        station.clock.sleep(4)
        station.turn()
        (ended,) = station.ended()
        alarm = station.alarm("piece")
        station.play_presses(3)
        refused = station.results[-1]
        station.ask("begin_piece", piece_id="P2")
        assert station.alarm("piece") is None
        station.play_presses(4)

    assert (ended["verdict"], ended["ended_by"]) == ("incomplete", "time")
    assert filled(ended) == ["pass", "pass", None]
    assert "it lacks PZ0/right; take it away, then begin the next piece" in str(alarm)
    assert str(refused.reason) == f"no_place: {alarm}"
    assert (station.results[-1].piece_id, station.results[-1].place) == ("P2", "PZ0/left")


def test_the_next_piece_ends_the_one_before(configure: Make) -> None:
    """Its missing places are said, and no press of it counts for the next."""
    with PieceStation(configure(plan())) as station:
        station.ask("begin_piece", piece_id="P1")
        station.play_presses(2)
        answer = station.ask("begin_piece", piece_id="P2")
        station.play()
        (ended,) = station.ended()
        said = station.said("piece")
        station.loop.publish_stats()
        assert station.loop.summary.fields()["pieces"] == {"incomplete": 1}

    assert answer == {"piece_id": "P2", "expected": ["PZ0/left"]}
    assert (ended["piece_id"], ended["verdict"], ended["ended_by"]) == ("P1", "incomplete", "next piece")
    assert (said["piece_id"], filled(said)) == ("P2", ["pass", None, None])


def pressing(station: PieceStation) -> None:
    station.play_until(lambda: station.loop.session is not None and station.loop.session.has_contact)


def three_presses(station: PieceStation) -> None:
    station.ask("begin_piece", piece_id="P1")
    station.play()


def one_begun(station: PieceStation) -> None:
    station.ask("begin_piece", piece_id="P1")


@pytest.mark.parametrize(
    ("before", "sentence"),
    [
        (three_presses, r"the piece P1 is over \(pass\); an id is used once"),
        (one_begun, "the piece P1 is in progress; an id is used once"),
        (pressing, "something presses the gel; lift the part, then begin the piece"),
    ],
)
def test_a_piece_that_cannot_begin_is_refused_and_nothing_changes(
    configure: Make, before: Callable[[PieceStation], None], sentence: str
) -> None:
    """With what to do; the page and MQTT get it, and the table of acts."""
    with PieceStation(configure(plan())) as station:
        before(station)
        said = station.said("piece")
        with pytest.raises(ValueError, match=sentence):
            station.ask("begin_piece", piece_id="P1")
        assert station.said("piece") == said


def test_a_press_that_began_before_its_piece_is_of_none(configure: Make) -> None:
    """The loop is some frames behind: when the piece is begun something presses already, and is not seen yet. It may
    be the piece before, so the request is refused."""
    with PieceStation(configure(plan(), pace=1.0)) as station:
        pressing(station)
        frames = station.parts.acquisition.status.frames
    with PieceStation(configure(plan(), pace=1.0)) as station:
        station.play_until(lambda: station.parts.acquisition.status.frames == frames - 8)
        station.read(10)
        station.parts.calls.post(lambda loop: station.ask("begin_piece", piece_id="P2"))
        station.look()
        with pytest.raises(ValueError, match="something presses the gel; lift the part, then begin"):
            station.play(1)
        station.play_presses(1)
    assert station.words == [("PZ0/left", "pass")]
    assert station.results[0].piece_id != "P2"


def test_nothing_is_counted_that_is_not_recorded(configure: Make) -> None:
    """While the database refuses the first press, the others are refused: they are pressed again."""
    with PieceStation(configure(plan(), presses=5)) as station:
        station.play_until(lambda: station.loop.session is not None)
        with station.refusing("presses"):
            station.play_until(lambda: station.loop.session.unrecorded == 2)
            with pytest.raises(ValueError, match="a press waits to be recorded"):
                station.ask("begin_piece")
        station.clock.sleep(2)
        station.play()
        ended = station.ended()

    assert station.words[:2] == [("PZ0/left", "pass"), (None, "rejected")]
    assert "the press before is not recorded yet" in str(station.results[1].reason)
    assert [one["verdict"] for one in ended] == ["pass"]
    assert len(station.words) == 5


def test_what_a_person_selected_since_the_press_stays_selected_over_a_restart(configure: Make) -> None:
    """The plan would select the place that is left, and its bundle would judge the part that lies elsewhere."""
    config = configure(plan("free", ("left", "middle")), presses=1)
    with PieceStation(config) as station:
        station.play_presses(1)
        station.turn()
        by_plan = station.parts.selection.part
        station.clock.sleep(1.0)
        station.select("right")
        station.turn()
    with PieceStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        station.turn()
        assert (by_plan, station.parts.selection.part) == (MIDDLE, RIGHT)


@pytest.mark.parametrize("is_lifted", [False, True])
def test_a_place_that_a_person_keeps_stays_selected_over_a_restart(configure: Make, is_lifted: bool) -> None:
    """Its press is recorded and not lifted, and the place that is left waits for its end: what is in use is selected
    again."""
    config = configure(plan("free", ("left", "middle")), presses=1)
    with PieceStation(config) as station:
        station.play_until(lambda: station.parts.selection.is_waiting)
        by_plan = station.parts.selection.selected
        station.clock.sleep(1.0)
        station.select("left")
        if is_lifted:
            station.play_until(lambda: not station.loop.session.has_contact)
            station.turn()
    with PieceStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        station.turn()
        assert (by_plan, station.parts.selection.part) == (MIDDLE, LEFT)


def test_what_a_person_selects_while_something_presses_stays_selected(configure: Make) -> None:
    """The press was of the last place but one, and the plan would select the place that is left."""
    with PieceStation(configure(plan("free", ("left", "middle")), presses=1)) as station:
        pressing(station)
        station.select("right")
        station.play_presses(1)
        station.play_until(lambda: not station.loop.session.has_contact)
        station.turn()
        assert (station.words, station.parts.selection.part) == ([("PZ0/left", "pass")], RIGHT)


def test_a_write_that_fails_in_the_middle_of_an_end_ends_nothing(configure: Make) -> None:
    """Press, piece and message are one transaction: it is tried again, and then there is one of each."""
    with PieceStation(configure(plan())) as station:
        station.play_presses(2)
        query = "SELECT count(*) FROM presses"
        execute = station.parts.store.write
        execute(
            "t",
            lambda it: it.execute(
                "CREATE TRIGGER no BEFORE UPDATE ON pieces BEGIN SELECT RAISE(FAIL, 'no'); END"
            ),
        )
        station.play_until(lambda: station.loop.is_halted)
        assert station.parts.store.read("t", lambda it: it.execute(query).fetchone()) == (2,)
        assert station.ended() == []
        execute("t", lambda it: it.execute("DROP TRIGGER no"))
        station.turn(2)
        station.play()
        assert [one["verdict"] for one in station.ended()] == ["pass"]
        assert station.parts.store.read("t", lambda it: it.execute(query).fetchone()) == (3,)


def test_a_begin_that_is_committed_and_reported_as_failed_is_known_at_the_next_turn(
    configure: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a disk that fails after the write: a press goes to the piece that the database has."""
    write = Store.write

    def fail_after(store: Store, doing: str, change: Callable[..., Any]) -> None:
        write(store, doing, change)
        raise StoreError("disk I/O error")

    with PieceStation(configure(plan(), presses=1)) as station:
        station.play_until(lambda: station.loop.session is not None)
        with monkeypatch.context() as patched:
            patched.setattr(Store, "write", fail_after)
            with pytest.raises(StoreError):
                station.find(Pieces).begin_piece("P1")
        station.play()
        assert station.results[0].piece_id == "P1"


def test_a_takeover_in_the_middle_of_a_piece_counts_for_the_places_after_it(
    tmp_path: Path, configure: Make, bundle: Path
) -> None:
    """The place before keeps its verdict, the next is judged by the bundle that took over, which fails it: so the piece
    fails. Each result names its bundle; after a restart the piece goes on, and stats count what ended in their run."""
    strict = variant(bundle, tmp_path / "strict", position="middle", revision=2, threshold={"value": 1e-6})
    config = configure(plan(), shadows=[strict])
    with PieceStation(config) as station:
        station.ask("begin_piece", piece_id="P1")
        station.play_presses(1)
        before = station.said("piece")
        old = station.parts.selection.inspector.bundle.digest
        station.parts.selection.exchange(Act(station.clock.time_ns(), "a test", "adopt_shadow"))
        station.turn()
        assert station.said("piece") == before
        station.play_presses(2)
        assert station.words == [("PZ0/left", "pass"), ("PZ0/middle", "fail")]
        assert station.results[1].bundle_id == Bundle.load(strict).digest != old
    with PieceStation(config) as station:
        assert filled(station.said("piece")) == ["pass", "fail", None]
        station.play_presses(1)
        (ended,) = station.ended()
        assert station.parts.status.view().piece_id is None
        station.loop.publish_stats()
        assert station.loop.summary.fields()["pieces"] == {"fail": 1}
    with PieceStation(config) as station:
        station.loop.publish_stats()
        assert station.loop.summary.fields()["pieces"] == {}, "of an earlier run"
    assert (ended["piece_id"], ended["verdict"]) == ("P1", "fail")
    assert filled(ended) == ["pass", "fail", "pass"]


def test_a_new_gel_a_reload_and_an_unsure_press_leave_the_piece_as_it_is(configure: Make) -> None:
    """Each place is judged by its own bundle, on the gel that is mounted then."""
    with PieceStation(configure(plan("free"))) as station:
        station.ask("begin_piece", piece_id="P1")
        station.play_presses(1)
        before = station.said("piece")
        station.ask("replace_gel")
        station.reload()

        assert station.said("piece") == before
        assert filled(before) == ["pass", None, None]


def test_a_place_whose_bundle_goes_with_a_reload_is_an_alarm(tmp_path: Path, configure: Make) -> None:
    """It cannot be pressed until the bundle is back; the piece waits, and goes on by itself."""
    with PieceStation(configure(plan())) as station:
        station.play_until(lambda: station.loop.session is not None)
        shutil.move(tmp_path / "bundles" / "middle", tmp_path / "middle")
        station.reload()
        station.play_presses(1)
        station.turn()
        assert "the place PZ0/middle of the piece has no bundle any more" in str(station.alarm("piece"))
        shutil.move(tmp_path / "middle", tmp_path / "bundles" / "middle")
        station.reload()
        station.turn()
        assert station.alarm("piece") is None
        assert station.parts.selection.part == MIDDLE


@pytest.fixture
def checked(configure: Make) -> Callable[[str], list[str]]:
    """What `gelgate check` says of the plan: its faults."""

    def check(tables: str) -> list[str]:
        with preflight(load_config(configure(tables)), SystemClock(), is_start=False) as found:
            return [f"{one.part}: {one.text}" for one in found.findings if one.error]

    return check


def test_the_check_names_places_without_bundle_and_locked_pieces(checked: Callable[[str], list[str]]) -> None:
    (lacking,) = checked(plan(names=("left", "behind")))
    (locked,) = checked(plan().replace(BEGUN, ""))

    assert checked(plan()) == []
    assert lacking.startswith("places: ")
    assert "no bundle for PZ0/behind; add one to [inspection]" in lacking
    assert locked.startswith("piece: ")
    assert "name begin_piece in [commands] under signed or unsigned" in locked


def test_a_plan_that_cannot_be_is_refused(configure: Make) -> None:
    with pytest.raises(ConfigError, match="the place PZ0/left is named twice, expected once"):
        load_config(configure(plan(names=("left", "left"))))
    with (
        pytest.raises(ConfigError, match="no bundle for PZ0/behind"),
        SteppedStation(configure(plan(names=("behind",)))),
    ):
        pass


OVERVIEW = """
[overview]
plugin = "virtual_overview"
codes = ["qr"]
part_pattern = "(?P<part>[^;]+);(?P<piece>.+)"
options = { parts = %s }
"""


def test_the_code_on_a_piece_begins_it_and_ends_the_one_before(configure: Make) -> None:
    """Also where the next piece comes in the middle: its press is not taken for the place of the other one."""
    codes = ["PZ0;1", "PZ0;1", "PZ0;2", "PZ0;2", "PZ0;2", "PZ0;2", "PZ0;1"]
    tables = plan().replace(BEGUN, "") + OVERVIEW % codes
    with PieceStation(configure(tables, presses=7)) as station:
        while not station.has_ended:
            station.find(Overview).camera.step()
            station.play(1)
        ended = station.ended()

    assert [(one["piece_id"], one["verdict"], one["ended_by"]) for one in ended] == [
        ("1", "incomplete", "next piece"),
        ("2", "pass", "complete"),
    ]
    assert [result.piece_id for result in station.results] == ["1", "1", "2", "2", "2", "2", None]
    assert station.words[2] == (None, "rejected")
    assert "the piece 1 is over (incomplete); an id is used once" in str(station.results[-1].reason)


class Labelled(PressStage):
    """The second press is no part's."""

    def __init__(self, label: PressLabel) -> None:
        self._labels = [None, label]

    def begin(self, label: PressLabel | None) -> PressLabel | None:
        return self._labels.pop(0) if self._labels else label

    def table(self, press: Press, row: PressRecord) -> StudyTable | None:
        return StudyTable(press.label, "", None) if isinstance(press.label, StudyLabel) else None


@pytest.mark.parametrize(
    "label", [ReferenceLabel("M1", "pass", 20), StudyLabel("gauge", 1, "7", "A", 1)], ids=lambda one: one.kind
)
def test_a_master_piece_and_a_study_are_of_no_piece(configure: Make, label: PressLabel) -> None:
    """Such a press is made in the middle of a piece, passes, and leaves it as it is: the next one is of the piece."""
    config = configure(plan(), presses=4)
    with PieceStation(config, stages={"labelled": Labelled(label)}) as station:
        station.play()
        (ended,) = station.ended()
        places = [result.place for result in station.results]
    assert (ended["verdict"], places) == ("pass", ["PZ0/left", None, "PZ0/middle", "PZ0/right"])


def test_a_station_without_a_plan_says_nothing_of_a_piece_that_an_earlier_plan_began(configure: Make) -> None:
    """The retained message is taken away, also where no piece was begun; with the plan again the piece goes on."""
    with PieceStation(
        configure("")
    ) as station:  # of a plan that nobody pressed, or of a database that is lost
        assert ("piece", b"") in [
            (one.topic, one.payload) for one in station.parts.publisher.retained_state.all()
        ]
    with PieceStation(configure(plan())) as station:
        station.ask("begin_piece", piece_id="P1")
    with PieceStation(configure("")) as station:
        assert station.said("piece") is None
        with pytest.raises(ValueError, match="'begin_piece' is off now: it is not configured"):
            station.ask("begin_piece")
    with PieceStation(configure(plan())) as station:
        assert station.said("piece")["piece_id"] == "P1"
