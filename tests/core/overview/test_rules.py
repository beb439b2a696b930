"""What a still of the overview camera says about a part, and which presses it admits."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from overview_stills import blank, encoded, with_data_matrix, with_qr, with_tag

from edge.core.imaging.quality import Reason
from edge.core.overview.rules import OverviewRules, read_codes, share_of_change
from edge.core.overview.view import Code, CodeKind, OverviewView, Zone
from edge.core.part_position import PartPosition
from edge.extras import is_installed

PZ0, PZ1, LEFT, RIGHT = (
    PartPosition(*one) for one in (("PZ0", "pos1"), ("PZ1", "pos1"), ("PZ2", "left"), ("PZ2", "right"))
)


def named_by(name: str) -> list[PartPosition]:
    """A station with three parts, one of them with two positions; PZ1 has another name."""
    return [
        one
        for one in (PZ0, PZ1, LEFT, RIGHT)
        if name in (one.part, str(one), *(["4711"] if one is PZ1 else []))
    ]


def looked(grey: NDArray[np.uint8], rules: OverviewRules) -> OverviewView:
    return rules.look(encoded(grey), grey)


def reason(view: OverviewView, rules: OverviewRules, selected: PartPosition = PZ0) -> Reason | None:
    refusal = rules.refusal(view, selected, named_by)
    return None if refusal is None else refusal.reason


BOTH = np.hstack([with_qr("PZ0;0042"), with_tag(3)])
OTHER_TAG = with_tag(3, cv2.aruco.DICT_APRILTAG_16h5)
MATRIX = GS1 = blank()
if is_installed("zxingcpp"):
    MATRIX, GS1 = with_data_matrix("PZ0;0042"), with_data_matrix("(01)09506000134352(17)260101", gs1=True)
READ: list[tuple[NDArray[np.uint8], list[CodeKind], str, list[str]]] = [
    *((np.rot90(with_tag(number)), ["apriltag"], "36h11", [str(number)]) for number in (0, 17, 586)),
    (BOTH, ["qr"], "36h11", ["PZ0;0042"]),
    (BOTH, ["qr", "apriltag"], "36h11", ["3", "PZ0;0042"]),
    (blank(), ["qr", "apriltag"], "36h11", []),
    (with_qr("PZ0\x1b[2J"), ["qr"], "36h11", ["PZ0\\x1b[2J"]),  # a terminal must not be reached
    (OTHER_TAG, ["apriltag"], "16h5", ["3"]),
    (OTHER_TAG, ["apriltag"], "36h11", []),
    (np.rot90(MATRIX), ["datamatrix"], "36h11", ["PZ0;0042"]),
    (np.rot90(255 - MATRIX), ["datamatrix"], "36h11", ["PZ0;0042"]),  # etched bright into a dark part
    (MATRIX, ["qr", "apriltag"], "36h11", []),
    (with_qr("PZ0"), ["datamatrix"], "36h11", []),
    (GS1, ["datamatrix"], "36h11", ["010950600013435217260101"]),  # `part_pattern` fits what is in the code
]


@pytest.mark.parametrize(("still", "kinds", "family", "texts"), READ)
def test_codes_are_read(
    still: NDArray[np.uint8], kinds: list[CodeKind], family: str, texts: list[str]
) -> None:
    """Of the kinds and the family that are asked for, turned ones too."""
    if "datamatrix" in kinds and not is_installed("zxingcpp"):
        pytest.skip("SKIPPED, NOT TESTED: the package zxing-cpp is not installed")
    assert [code.text for code in read_codes(np.ascontiguousarray(still), kinds, family)] == texts


def test_a_code_that_is_no_utf_8_is_not_read_and_ends_nothing() -> None:
    """OpenCV raises UnicodeDecodeError for a code in Kanji mode; the press is refused as one without a code."""
    still, rules = with_qr("部品", cv2.QRCODE_ENCODER_MODE_KANJI), OverviewRules(codes=("qr",))

    assert read_codes(still, ["qr"]) == ()
    assert reason(looked(still, rules), rules) is Reason.NO_PART_ID


EMPTY = np.full((240, 320), 100, np.uint8)
PART = EMPTY.copy()
PART[:120, :160] = 180
TAGS = OverviewRules(codes=("apriltag",), parts={"17": "PZ0", "18": "PZ0"})
LEFT_HALF, QR = replace(TAGS, zone=Zone(width=0.5)), OverviewRules(codes=("qr",))
PATTERN = replace(QR, pattern=re.compile(r"(?P<part>[^;]+);\d+"))
ADMITTED: list[tuple[NDArray[np.uint8], OverviewRules, PartPosition, Reason | None]] = [
    (with_tag(17), TAGS, PZ0, None),
    (with_tag(19), TAGS, PZ0, Reason.OTHER_PART),
    (with_tag(17), TAGS, PZ1, Reason.OTHER_PART),
    (blank(), TAGS, PZ0, Reason.NO_PART_ID),
    (np.hstack([with_tag(17), with_tag(18)]), TAGS, PZ0, None),
    (np.hstack([with_tag(17), with_tag(19)]), TAGS, PZ0, Reason.NO_PART_ID),  # it must be alone in the region
    (np.hstack([with_tag(17), with_tag(19)]), LEFT_HALF, PZ0, None),  # what waits next to the station
    (np.hstack([blank(), with_tag(17)]), LEFT_HALF, PZ0, Reason.NO_PART_ID),
    (with_qr("PZ0;0042"), PATTERN, PZ0, None),
    (with_qr("PZ1;0042"), PATTERN, PZ0, Reason.OTHER_PART),
    (with_qr("PZ0"), PATTERN, PZ0, Reason.OTHER_PART),
    (with_qr("PZ2"), QR, LEFT, None),  # each of its positions: a person has selected it
    (with_qr("PZ2"), QR, RIGHT, None),
    (with_qr("PZ2"), QR, PZ0, Reason.OTHER_PART),
    (PART, OverviewRules(empty=EMPTY), PZ0, None),
    (EMPTY, OverviewRules(empty=EMPTY), PZ0, Reason.NO_PART),
    (with_tag(17), replace(TAGS, empty=with_tag(17)), PZ0, None),  # a code that is read is a part
]


@pytest.mark.parametrize(("still", "rules", "selected", "expected"), ADMITTED)
def test_the_selected_part_is_admitted_and_another_is_not(
    still: NDArray[np.uint8], rules: OverviewRules, selected: PartPosition, expected: Reason | None
) -> None:
    """By its code, as a name or by a pattern, alone in the region, and by a change of the empty station."""
    view = looked(still, rules)
    assert reason(view, rules, selected) is expected
    assert rules.empty is None or view.is_present is (expected is None)


def test_presence_is_a_share_of_change() -> None:
    """A quarter of the view is a quarter; brighter light everywhere is no part."""
    assert share_of_change(PART, EMPTY) == pytest.approx(0.25, abs=0.02)
    assert share_of_change(EMPTY + np.uint8(40), EMPTY) == 0.0


@pytest.mark.parametrize(
    ("texts", "position"),
    [
        (["PZ1"], PZ1),
        (["PZ1/pos1"], PZ1),
        (["4711"], PZ1),
        (["4711", "PZ1"], PZ1),
        (["PZ2/left"], LEFT),
        (["PZ2/left", "PZ2"], LEFT),
        (["PZ2"], None),
        (["PZ9"], None),
        (["PZ0", "PZ1"], None),
        (["PZ1", "lot 7"], None),
        ([], None),
    ],
)
def test_codes_that_name_one_position_select_it(texts: list[str], position: PartPosition | None) -> None:
    """By part, by part and position, or by a name; several codes must agree. What they select, they admit."""
    rules = OverviewRules(codes=("qr",), select=True)
    view = OverviewView(b"", codes=tuple(Code("qr", text) for text in texts))

    assert rules.choose_position(view, named_by) == position
    assert position is None or reason(view, rules, position) is None


def test_without_a_still_nothing_that_is_asked_for_is_admitted() -> None:
    """A camera that is away refuses presses only where presence or an id is asked for."""
    view = OverviewView(None, fault="the overview camera was unplugged")

    assert reason(view, OverviewRules(codes=("qr",))) is Reason.NO_OVERVIEW
    assert reason(view, OverviewRules(empty=blank())) is Reason.NO_OVERVIEW
    assert reason(view, OverviewRules()) is None


@pytest.mark.parametrize(("jpeg", "fault"), [(None, None), (b"still", "no answer")])
def test_a_look_without_a_still_says_why(jpeg: bytes | None, fault: str | None) -> None:
    """Neither, or both, would admit a press that nobody looked at."""
    with pytest.raises(ValueError, match="a still, or a fault"):
        OverviewView(jpeg, fault)


def test_stills_alone_ask_for_nothing() -> None:
    """Without codes and presence every press is admitted, and nothing is known of the part."""
    view = looked(with_tag(17), OverviewRules())

    assert reason(view, OverviewRules()) is None
    assert (view.codes, view.is_present) == ((), None)


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0, 0.999), st.floats(0, 0.999))
def test_a_region_is_never_empty(w: int, h: int, left: float, top: float) -> None:
    """Of a picture of any size at least one pixel is looked at."""
    zone = Zone(left, top, (1 - left) / 2, (1 - top) / 2)

    assert zone.of(np.zeros((h, w), np.uint8)).size >= 1


@pytest.mark.parametrize(
    "sides", [(0.5, 0, 0.6, 1), (0, 0, 0, 1), (-0.1, 0, 0.5, 1), (0, float("nan"), 1, 1)]
)
def test_a_region_lies_in_the_picture(sides: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="lies in it, found"):
        Zone(*sides)


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (1, 300), (300, 1), (20, 20), (21, 21)])
def test_a_region_too_small_for_a_code_has_none(size: tuple[int, int]) -> None:
    """The readers are not given what they cannot take."""
    kinds: list[CodeKind] = ["qr", "apriltag", *(["datamatrix"] if is_installed("zxingcpp") else [])]
    assert read_codes(np.full(size, 150, np.uint8), kinds) == ()
