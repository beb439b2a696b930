"""A press anywhere through the gateway: its verdict, what its result states of the pose, and its rejection."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import turned_parts as parts
from numpy.typing import NDArray
from registered_bundle import registered

from edge.clock import ManualClock, SystemClock
from edge.core.contact.mask import Touch
from edge.core.imaging.frames import CameraFrame
from edge.core.press import JudgedFrame, Press, ScarFindings
from edge.core.press_again import Costs, Plan
from edge.core.registration.pose import Pose
from edge.core.sink_context import Place
from edge.core.verdict import Blame, Cause, Kind
from edge.features.black_box.replay import judge_again
from edge.features.black_box.stage import BlackBox
from edge.features.press_again import PressAgain, find_seen
from edge.features.scars import mask_scars
from edge.gateway.pictures import PressDrawing
from edge.gateway.recorder import PressReport, Recorder, draw_archived, press_drawing
from edge.model.comparison import compare_press
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.press_archive import ArchiveFolder, PressArchive
from edge.store.press_store import Store
from edge.store.ulid import new_ulid


@pytest.fixture(scope="module")
def inspector() -> Inspector:
    return Inspector(Scorer(registered().bundle(), 1), SystemClock())


def jpeg_frame(rgb: NDArray[np.uint8]) -> CameraFrame:
    payload = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
    return CameraFrame(payload.tobytes(), 0, 0, True)


def inspect(inspector: Inspector, rgb: NDArray[np.uint8]) -> Press:
    judged = JudgedFrame(jpeg_frame(rgb), Touch(0.1))
    return replace(inspector.inspect(judged.frame, judged.touch), judged=judged)


Record = Callable[[Press], PressReport]


@pytest.fixture
def record(tmp_path: Path, inspector: Inspector) -> Iterator[Record]:
    """Records a press; gives its report, with the result that a subscriber reads and its picture."""
    with Store(tmp_path / "presses.db") as store:
        recorder = Recorder(
            store, "SIM1", Place("site", "line", "station"), SystemClock(), lambda drawing: None
        )
        ids = {"bundle_id": inspector.bundle.digest}
        yield lambda press: recorder.record(
            recorder.prepare(replace(press, press_id=new_ulid(0), **ids), inspector)  # type: ignore[arg-type]
        )


def test_a_press_anywhere_passes_and_its_result_says_where(record: Record, inspector: Inspector) -> None:
    """Shift and turn between two presses are those that the formula gave, in mm and degrees; finding them is a stage of
    its own next to trunk and head."""
    here, there = Pose(-4.0, 6.0, 0.5), Pose(8.0, 1.0, 1.25)
    found = [inspect(inspector, parts.press(parts.BLOCK, pose, seed=9)) for pose in (here, there)]
    first, second = (record(press).result.pose for press in found)

    assert [press.word for press in found] == ["pass", "pass"]
    assert [list(press.latency_ms) for press in found] == [["decode", "registration", "trunk", "head"]] * 2
    assert first is not None
    assert second is not None
    assert second.turn_deg - first.turn_deg == pytest.approx(np.degrees(0.75), abs=0.5)
    assert first.match > 0.9
    assert 0 < first.x_sd_mm < 0.1


def test_a_press_that_is_scored_ahead_has_the_same_verdict_once(inspector: Inspector) -> None:
    """What is scored ahead serves the very frame and touch only, is trusted no longer than the bundle, and leaves."""
    frames = [
        jpeg_frame(parts.press(parts.BLOCK, pose)) for pose in (Pose(-4.0, 6.0, 0.5), Pose(8.0, 1.0, 1.25))
    ]
    touch, at_once = Touch(0.1), [inspector.inspect(frame, Touch(0.1)) for frame in frames]
    for asked, expected in zip(frames, at_once, strict=True):
        inspector.examine_ahead(frames[0], touch)
        press = inspector.inspect(asked, touch)
        np.testing.assert_array_equal(press.score_map, expected.score_map)
        assert press.verdict == expected.verdict

    inspector.examine_ahead(frames[0], touch)
    inspector.fault = "the golden frames score differently"
    try:
        assert inspector.inspect(frames[0], touch).error == inspector.fault
    finally:
        inspector.fault = None
    late = replace(frames[0], is_on_demand=False)
    inspector.examine_ahead(late, touch)
    assert "stale" in str(inspector.inspect(late, touch, came_ns=-(10**12)).reason)


def test_what_left_the_field_is_published_and_dark(record: Record, inspector: Inspector) -> None:
    """A part at the rim states what was not judged, and the same press without its registration is drawn brighter; one
    in the middle states nothing unseen."""
    middle, rim = (inspect(inspector, parts.press(parts.BLOCK, Pose(x))) for x in (0.0, 30.0))
    shares = [report.result.pose and report.result.pose.unseen_share for report in map(record, (middle, rim))]
    drawings = [
        press_drawing(press, inspector.bundle, "", "jpeg") for press in (rim, replace(rim, registered=None))
    ]
    dark, bright = (
        cv2.imdecode(np.frombuffer(draw().sheet, np.uint8), cv2.IMREAD_COLOR) for draw in drawings if draw
    )

    assert (shares[0] or 0) < 0.05 < (shares[1] or 0)
    assert float(np.mean(dark)) < float(np.mean(bright)) - 1


def relief(rgb: NDArray[np.generic]) -> NDArray[np.float64]:
    """How far each pixel is from the free gel: where the part is, whichever way the light falls on it."""
    return np.asarray(np.abs(rgb.astype(np.float64) - parts.free_gel()).sum(axis=2))


def test_a_press_stands_above_its_nominal_press_where_it_lies(inspector: Inspector) -> None:
    """The nominal press is shifted and turned as the press was; and of the part alone nothing differs much, where a
    bump that no nominal press has is clearly brighter or darker."""
    pose = Pose(8.0, 1.0, 1.25)
    bump = (4.0, -32.0, 3.5, 4.0)
    press = inspect(inspector, parts.press((*parts.BLOCK, bump), pose, seed=9))
    assert press.rgb is not None
    assert press.score_map is not None
    assert press.registered is not None
    found = compare_press(inspector.bundle, press.rgb, press.score_map, press.registered)
    assert found is not None
    seen = np.abs(found.difference).max(axis=2)
    row, column = np.unravel_index(int(press.score_map.argmax()), seen.shape)

    inside = np.ptp(found.nominal, axis=2) > 0  # beyond the pose of the bank it is paper

    assert inside.mean() > 0.5
    assert np.corrcoef(relief(press.rgb)[inside], relief(found.nominal)[inside])[0, 1] > 0.7
    assert found.name.startswith("nominal press press ")
    assert seen[max(0, row - 5) : row + 6, max(0, column - 5) : column + 6].max() > 4 * np.median(seen)


def test_only_a_press_that_does_not_pass_is_compared(inspector: Inspector) -> None:
    """Its picture has a second row; that of a pass, and of any press with an old bundle, has one."""
    old = replace(inspector.bundle, nominal_pictures=None)
    passed = inspect(inspector, parts.press(parts.BLOCK, Pose(8.0, 1.0, 1.25), seed=9))
    assert passed.verdict is not None
    failed = replace(passed, verdict=replace(passed.verdict, kind=Kind.FAIL))
    drawings = [
        press_drawing(press, bundle, "", "png")
        for press, bundle in ((passed, inspector.bundle), (failed, inspector.bundle), (failed, old))
    ]
    heights = [
        cv2.imdecode(np.frombuffer(draw().sheet, np.uint8), cv2.IMREAD_COLOR).shape[0]
        for draw in drawings
        if draw
    ]

    assert heights[0] == heights[2]
    assert heights[1] > 1.8 * heights[0]


def test_its_picture_is_drawn_again_as_it_was(tmp_path: Path, inspector: Inspector) -> None:
    """From the archive, byte for byte: with what lay beyond the field dark, and the places under scars."""
    drawings: list[PressDrawing] = []
    press = inspect(inspector, parts.press(parts.BLOCK, Pose(30.0)))
    assert press.rgb is not None
    masked = np.zeros(press.rgb.shape[:2], np.bool_)
    masked[20:60, 30:90] = True
    scarred = mask_scars(press, ScarFindings(Blame(Cause.GEL, "a scar"), masked), inspector.bundle)
    with Store(tmp_path / "presses.db") as store:
        archive = PressArchive(store.path.with_suffix(".archive"), 9, 10**9)
        box = BlackBox(archive, store, "site/line/station", 1, Mock())
        box.mount(store.gel("SIM1", 0))
        place = Place("site", "line", "station")
        recorder = Recorder(store, "SIM1", place, SystemClock(), drawings.append, [box])
        for one in (press, scarred):
            one = replace(one, press_id=new_ulid(0), bundle_id=inspector.bundle.digest)
            waiting = recorder.prepare(one, inspector)
            gel = recorder.record(waiting).gel
            box.record(one, gel)
            recorder.follow(waiting, gel)
            again = draw_archived(one.press_id, store, [inspector.bundle], "jpeg")
            assert again == drawings[-1].draw()
    assert drawings[0].draw().sheet != drawings[1].draw().sheet


def test_a_press_whose_pose_is_not_found_is_rejected(record: Record, inspector: Inspector) -> None:
    """Another part is no pass and no fail: the reason and a sentence are published."""
    press = inspect(inspector, parts.press(parts.OTHER, Pose(3.0, -2.0, 0.4)))
    result = record(press).result

    assert press.word == "rejected"
    assert str(result.reason).startswith("no_pose: the part is not recognised")
    assert result.pose is None


Judge = Callable[..., list[Press]]


@pytest.fixture
def judge_twice(tmp_path: Path, inspector: Inspector) -> Iterator[Judge]:
    """Judges two presses of a piece as a station that asks for a second one up to twice the threshold; each is archived
    and judged again from there, with the same verdict."""

    def judge(
        *pictures: NDArray[np.uint8],
        bound: float = 2.0,
        change: Callable[[Press], Press] = lambda press: press,
    ) -> list[Press]:
        threshold = inspector.bundle.manifest.threshold.value
        again = PressAgain(Costs(1, 1, 1, 0.01), 30.0, ManualClock(), Mock())
        again.use(inspector)
        again._plan = Plan("", bound * threshold)
        presses = []
        for rgb in pictures:
            press = again.judge(change(inspect(inspector, rgb)), None, inspector)
            press = replace(press, press_id=new_ulid(0), bundle_id=inspector.bundle.digest)
            press = box.keep(press, inspector)
            box.record(press, store.gel("SIM1", 0))
            archived = folder.press(press.press_id, press.evidence)
            assert judge_again(archived, folder, inspector).now.verdict == press.verdict
            presses.append(press)
        return presses

    with Store(tmp_path / "presses.db") as store:
        folder = ArchiveFolder(store.path.with_suffix(".archive"))
        box = BlackBox(PressArchive(folder.folder, 9, 10**9), store, "site/line/station", 1, Mock())
        box.mount(store.gel("SIM1", 0))
        yield judge


HERE, THERE = Pose(-4.0, 6.0, 0.5), Pose(3.0, 1.0, 0.8)
# Bumps that no nominal press has, which score 1.25 to 1.5 times the threshold, at their places on the part.
BUMP, ELSEWHERE = (4.0, -32.0, 3.5, 1.0), (20.0, 20.0, 3.5, 1.0)


def test_damage_is_at_one_place_of_the_part_in_both_presses(judge_twice: Judge, inspector: Inspector) -> None:
    """However the part lies the second time. A press that shows as much elsewhere shows no damage of this piece."""
    damaged = [parts.press((*parts.BLOCK, BUMP), pose, seed=k) for k, pose in enumerate((HERE, THERE))]
    elsewhere = parts.press((*parts.BLOCK, ELSEWHERE), THERE, seed=1)
    same = judge_twice(*damaged)
    other = judge_twice(damaged[0], elsewhere)

    assert [press.word for press in same] == ["unsure", "fail"]
    assert [press.word for press in other] == ["unsure", "pass"]
    threshold = inspector.bundle.manifest.threshold.value
    for press in (same[1], other[1]):
        assert press.again is not None
        assert (press.again.own_score or 0) > threshold
        assert ((press.score or 0) > threshold) == (press.word == "fail")


def test_a_fail_by_both_presses_says_where(judge_twice: Judge, record: Record) -> None:
    """Also where the second one alone would pass; its cause is that of the first, whose places were looked at."""
    causes = {
        "fail": Blame(Cause.PART, "no mark of the gel"),
        "pass": Blame(Cause.UNSURE, "no place is above"),
    }
    heights = ((HERE, 0.75), (THERE, 0.635))
    pictures = [parts.press((*parts.BLOCK, (*BUMP[:3], height)), pose) for pose, height in heights]
    _, second = judge_twice(
        *pictures, change=lambda press: replace(press, scars=ScarFindings(causes[press.word]))
    )
    result = record(second).result

    assert second.again is not None
    assert second.verdict is not None
    assert 0 < (second.again.own_score or 9) < (second.verdict.threshold or 0)
    assert (result.verdict, len(result.defects or ())) == (Kind.FAIL, 1)
    assert second.blame == causes["fail"]
    assert (result.score_ratio or 0) > 1


def test_what_only_the_second_press_shows_clearly_fails(judge_twice: Judge) -> None:
    """Above the bound a first press fails at once; so does a second one, whatever the first showed there."""
    faint, elsewhere = (4.0, -32.0, 3.5, 0.75), parts.press((*parts.BLOCK, ELSEWHERE), THERE, seed=1)
    first, second = judge_twice(parts.press((*parts.BLOCK, faint), HERE), elsewhere, bound=1.4)

    assert (first.word, second.word) == ("unsure", "fail")
    assert second.again is not None
    assert (second.again.own_score, second.again.first_score) == (None, first.score)


def _looks_the_same_elsewhere(press: Press) -> Press:
    assert press.registered is not None
    return replace(press, registered=replace(press.registered, is_unique=False))


def _scores_missing_relief(press: Press) -> Press:
    assert press.score_map is not None
    return replace(press, score_map=press.score_map / 2)


@pytest.mark.parametrize(
    "change",
    [
        lambda press: replace(press, registered=None),
        _looks_the_same_elsewhere,
        _scores_missing_relief,
    ],
    ids=["no pose", "several places look the same", "the score is of no place"],
)
def test_where_places_cannot_be_compared_the_lower_score_decides(
    judge_twice: Judge, change: Callable[[Press], Press]
) -> None:
    """So the piece fails, whose presses are high at two places."""
    bumps = (HERE, BUMP), (THERE, ELSEWHERE)
    pictures = [parts.press((*parts.BLOCK, bump), pose, seed=k) for k, (pose, bump) in enumerate(bumps)]
    presses = judge_twice(*pictures, change=change)

    assert [press.word for press in presses] == ["unsure", "fail"]
    assert presses[1].again is not None
    assert presses[1].again.own_score is None


def test_a_threshold_below_zero_has_no_share(inspector: Inspector) -> None:
    press = inspect(inspector, parts.press((*parts.BLOCK, BUMP), HERE))
    assert press.verdict is not None
    assert find_seen(press) is not None
    assert find_seen(replace(press, verdict=replace(press.verdict, threshold=-1.0))) is None
