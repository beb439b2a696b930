"""The code on the part: it selects the bundle that judges the press, or admits it, by any name of the bundle."""

from pathlib import Path

import pytest
from station import station_config, two_parts
from stepped_station import SteppedStation

from edge.core.part_position import PartPosition
from edge.core.verdict import Kind
from edge.features.overview import Overview
from edge.messaging.result_payload import ResultPayload

PZ0, PZ1 = PartPosition("PZ0", "pos1"), PartPosition("PZ1", "pos1")


@pytest.fixture
def bundles(tmp_path: Path, bundle: Path) -> str:
    """Two bundles that differ in part and threshold: every press passes the second, which has another name."""
    two_parts(tmp_path, bundle)
    return f'bundles = [{{ path = "{tmp_path / "a"}" }}, {{ path = "{tmp_path / "b"}", names = ["4711"] }}]'


def station(folder: Path, recording: Path, bundles: str, codes: list[str], *, select: bool) -> SteppedStation:
    """Three presses, the second one dented, with these codes on their parts."""
    table = f'[overview]\nplugin = "virtual_overview"\ncodes = ["qr"]\noptions = {{ parts = {codes} }}\n'
    table += f"select = {str(select).lower()}\n"
    return SteppedStation(station_config(folder / "station", recording, bundles, tables=table))


def play(playing: SteppedStation, presses: int = 3) -> list[ResultPayload]:
    """Both cameras are read and the loop looks, in turn, until that number of presses is recorded."""
    while len(playing.reports) < presses:
        assert not playing.has_ended
        playing.find(Overview).camera.step()
        playing.play(1)
    return playing.results


def test_the_code_selects_the_bundle_of_this_press(tmp_path: Path, recording: Path, bundles: str) -> None:
    """The dented press is judged as PZ1, with its threshold, and the next one as PZ0 again; the table of acts has both
    changes, with the code that was read and the parts before and after."""
    with station(tmp_path, recording, bundles, ["PZ0", "4711", "PZ0"], select=True) as playing:
        results = play(playing)
        acts = [act for act in playing.parts.store.acts() if act.verb == "select_part"]

    assert [(one.part, one.verdict) for one in results] == [
        (part, Kind.PASS) for part in ("PZ0", "PZ1", "PZ0")
    ]
    assert results[0].bundle_id == results[2].bundle_id != results[1].bundle_id
    assert results[0].threshold == results[2].threshold != results[1].threshold
    assert [(act.who, act.outcome, act.arguments["codes"]) for act in acts] == [
        ("the overview camera", "done", ["PZ0"]),
        ("the overview camera", "done", ["4711"]),
    ]
    assert (acts[1].before, acts[1].after) == (PZ0._asdict(), PZ1._asdict())


def test_an_unknown_code_is_refused_and_selects_none(tmp_path: Path, recording: Path, bundles: str) -> None:
    """With what was read, and what is in use."""
    with station(tmp_path, recording, bundles, ["4711", "PZ9", "4711"], select=True) as playing:
        results = play(playing)

    assert [one.verdict for one in results] == [Kind.PASS, Kind.REJECTED, Kind.PASS]
    assert results[1].reason == (
        "other_part: the code 'PZ9' (qr), which is part 'PZ9', for which this station has no bundle, the bundle in use "
        "is for PZ1/pos1; press that part, or select the other bundle"
    )


def test_an_unrecorded_selection_refuses_the_press(tmp_path: Path, recording: Path, bundles: str) -> None:
    """It is not judged by the other part's bundle, nothing of it is in the table of acts, and the next press may
    select again."""
    with station(tmp_path, recording, bundles, ["4711"], select=True) as playing:
        playing.loop.step(None)
        with playing.refusing("selected"):
            refused = play(playing, presses=1)[0]
            part = playing.parts.selection.part
            acts = playing.parts.store.acts()
        results = play(playing)

    assert (refused.part, refused.verdict, part, acts) == ("PZ0", Kind.REJECTED, PZ0, [])
    assert refused.reason is not None
    assert refused.reason.startswith(
        "other_part: the code '4711' (qr), which is of PZ1/pos1, the bundle in use is for PZ0"
    )
    assert "it could not be selected" in refused.reason
    assert "no room" in refused.reason
    assert [one.part for one in results] == ["PZ0", "PZ1", "PZ1"]


def test_without_select_a_code_admits_by_every_name(tmp_path: Path, recording: Path, bundles: str) -> None:
    """The selected part is PZ1: its other name and its position are admitted, and the other part is refused."""
    with station(tmp_path, recording, bundles, ["4711", "PZ0", "PZ1/pos1"], select=False) as playing:
        playing.ask("select_part", part="PZ1")
        results = play(playing)

    assert [one.part for one in results] == ["PZ1"] * 3
    assert [one.verdict for one in results] == [Kind.PASS, Kind.REJECTED, Kind.PASS]


def test_a_bundle_whose_golden_frames_failed_gives_no_verdict_when_a_code_selects_it_again(
    tmp_path: Path, recording: Path, bundles: str
) -> None:
    """Its frames are scored again after the change; until then the last outcome counts."""
    with station(tmp_path, recording, bundles, ["4711"], select=True) as playing:
        inspector = playing.parts.selection.bundles[PZ1].inspector
        inspector.fault = "golden frame 0 scores 9"
        result = play(playing, presses=1)[0]

    assert (result.part, result.verdict, result.error) == ("PZ1", None, "golden frame 0 scores 9")
