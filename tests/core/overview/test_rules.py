"""What a still of the overview camera says about a part, and which presses it admits."""

import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from overview_stills import blank, encoded, with_data_matrix, with_qr, with_tag

from edge.core.imaging.quality import Reason
from edge.core.overview.codes import Code, CodeKind, read_codes
from edge.core.overview.presence import Zone, share_of_change
from edge.core.overview.rules import OverviewRules, OverviewView
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


def test_the_selected_part_is_admitted_and_another_is_not() -> None:
    """The code's text is the part; `parts` names it where it differs."""
    rules = OverviewRules(codes=("apriltag",), parts={"17": "PZ0"})

    assert reason(looked(with_tag(17), rules), rules) is None
    assert reason(looked(with_tag(18), rules), rules) is Reason.OTHER_PART
    assert reason(looked(with_tag(17), rules), rules, PZ1) is Reason.OTHER_PART
    assert reason(looked(blank(), rules), rules) is Reason.NO_PART_ID


def test_the_group_part_of_the_pattern_is_the_part() -> None:
    """A serial number in the same code is no matter; a text without the pattern is another part."""
    rules = OverviewRules(codes=("qr",), pattern=re.compile(r"(?P<part>[^;]+);\d+"))

    assert reason(looked(with_qr("PZ0;0042"), rules), rules) is None
    assert reason(looked(with_qr("PZ1;0042"), rules), rules) is Reason.OTHER_PART
    assert reason(looked(with_qr("PZ0"), rules), rules) is Reason.OTHER_PART


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


@pytest.mark.parametrize("selected", [LEFT, RIGHT])
def test_a_code_of_a_part_alone_admits_each_of_its_positions(selected: PartPosition) -> None:
    """The position is then what a person has selected."""
    rules = OverviewRules(codes=("qr",))
    view = OverviewView(b"", codes=(Code("qr", "PZ2"),))

    assert reason(view, rules, selected) is None
    assert reason(view, rules) is Reason.OTHER_PART


def test_codes_of_two_parts_admit_none() -> None:
    """The selected part must be alone in the region."""
    rules = OverviewRules(codes=("apriltag",), parts={"17": "PZ0", "18": "PZ0"})

    assert reason(looked(np.hstack([with_tag(17), with_tag(18)]), rules), rules) is None
    assert reason(looked(np.hstack([with_tag(17), with_tag(19)]), rules), rules) is Reason.NO_PART_ID


def test_codes_outside_the_region_are_not_seen() -> None:
    """A part that waits next to the station admits nothing."""
    rules = OverviewRules(codes=("apriltag",), parts={"17": "PZ0"}, zone=Zone(width=0.5))

    assert reason(looked(np.hstack([with_tag(17), with_tag(19)]), rules), rules) is None
    assert reason(looked(np.hstack([blank(), with_tag(17)]), rules), rules) is Reason.NO_PART_ID


def test_presence_is_a_change_of_the_empty_station() -> None:
    """A quarter of the view is a quarter; brighter light everywhere is no part."""
    empty = np.full((240, 320), 100, np.uint8)
    part = empty.copy()
    part[:120, :160] = 180
    rules = OverviewRules(empty=empty)

    assert share_of_change(part, empty) == pytest.approx(0.25, abs=0.02)
    assert share_of_change(empty + np.uint8(40), empty) == 0.0
    assert reason(looked(part, rules), rules) is None
    assert reason(looked(empty, rules), rules) is Reason.NO_PART
    assert looked(part, rules).is_present is True
    assert looked(empty, rules).is_present is False


def test_a_code_that_is_read_is_a_part() -> None:
    """Also where the picture of the empty station shows no change."""
    rules = OverviewRules(codes=("apriltag",), parts={"17": "PZ0"}, empty=with_tag(17))

    assert looked(with_tag(17), rules).is_present is True
    assert reason(looked(with_tag(17), rules), rules) is None


def test_without_a_still_nothing_that_is_asked_for_is_admitted() -> None:
    """A camera that is away refuses presses only where presence or an id is asked for."""
    view = OverviewView(None, fault="the overview camera was unplugged")

    assert reason(view, OverviewRules(codes=("qr",))) is Reason.NO_OVERVIEW
    assert reason(view, OverviewRules(empty=blank())) is Reason.NO_OVERVIEW
    assert reason(view, OverviewRules()) is None


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
    """Anything else is refused with what was found."""
    with pytest.raises(ValueError, match="lies in it, found"):
        Zone(*sides)


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (1, 300), (300, 1), (20, 20), (21, 21)])
def test_a_region_too_small_for_a_code_has_none(size: tuple[int, int]) -> None:
    """The readers are not given what they cannot take."""
    kinds: list[CodeKind] = ["qr", "apriltag", *(["datamatrix"] if is_installed("zxingcpp") else [])]
    assert read_codes(np.full(size, 150, np.uint8), kinds) == ()
