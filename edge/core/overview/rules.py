"""Before a press: what a still of the overview camera says, and whether the part in it is the selected one.

QR and AprilTag are read by OpenCV, DataMatrix by zxing-cpp (the extra `datamatrix`).
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.quality import Reason, Rejection
from edge.core.overview.view import PRESENT_SHARE, Code, CodeKind, OverviewView, TagFamily, Zone
from edge.core.part_position import PartPosition
from edge.core.printable import printable, score_texts
from edge.core.sentence import Sentence

__all__ = ["OverviewRules", "read_codes", "share_of_change"]

# Both pictures are compared at about this width: a part that matters is larger than 1/160 of the view.
COMPARED_PX: Final = 160
# A difference above the noise of a webcam's blurred picture and its JPEG.
LEVELS: Final = 20.0
# Longer than any id on a part: a QR code has room for 4,296 letters, a DataMatrix for 2,335. This text is published.
MOST_LETTERS: Final = 256


def read_codes(
    grey: NDArray[np.uint8], kinds: Sequence[CodeKind], family: TagFamily = "36h11"
) -> tuple[Code, ...]:
    """Every code of these kinds, sorted, each once. grey: uint8 (h, w). Not for two threads at once."""
    codes = {
        *(_qr_codes(grey) if "qr" in kinds else ()),
        *(_april_tags(grey, family) if "apriltag" in kinds else ()),
        *(_data_matrices(grey) if "datamatrix" in kinds else ()),
    }
    return tuple(sorted(codes, key=lambda code: (code.kind, code.text)))


def _qr_codes(grey: NDArray[np.uint8]) -> list[Code]:
    # OpenCV hands a code in Kanji mode to Python as UTF-8, which it is not: the id cannot be read, and others neither.
    try:
        _, texts, _, _ = _qr_reader().detectAndDecodeMulti(grey)
    except UnicodeDecodeError:
        return []
    return [Code("qr", printable(text)[:MOST_LETTERS]) for text in texts if text]


def _april_tags(grey: NDArray[np.uint8], family: TagFamily) -> list[Code]:
    _, numbers, _ = _tag_reader(family).detectMarkers(grey)
    return [] if numbers is None else [Code("apriltag", str(int(number))) for number in numbers.ravel()]


def _data_matrices(grey: NDArray[np.uint8]) -> list[Code]:
    """The text as it is in the code, without brackets around the fields of GS1."""
    import zxingcpp

    barcodes = zxingcpp.read_barcodes(
        grey, formats=zxingcpp.BarcodeFormat.DataMatrix, text_mode=zxingcpp.TextMode.Plain
    )
    return [
        Code("datamatrix", printable(barcode.text)[:MOST_LETTERS]) for barcode in barcodes if barcode.text
    ]


_qr_reader = cache(cv2.QRCodeDetector)


@cache
def _tag_reader(family: TagFamily) -> Any:
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(_FAMILIES[family]))


_FAMILIES: Final[dict[TagFamily, int]] = {
    "36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "16h5": cv2.aruco.DICT_APRILTAG_16h5,
}


def share_of_change(grey: NDArray[np.uint8], empty: NDArray[np.uint8]) -> float:
    """Measure the share of pixels that differ from the empty station. Both uint8 (h, w); their sizes may differ.

    A change of the light of the entire view is taken out: it is the median of the differences.
    """
    h, w = empty.shape
    size = (min(w, COMPARED_PX), max(1, round(h * min(w, COMPARED_PX) / w)))
    difference = _small(grey, size) - _small(empty, size)
    return float((np.abs(difference - np.median(difference)) > LEVELS).mean())


def _small(grey: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.float32]:
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return cv2.GaussianBlur(small, (0, 0), 1.0).astype(np.float32)


NamedBy = Callable[[str], Collection[PartPosition]]
"""A part's name -> the positions of the station's bundles that have it; none for an unknown name."""


@dataclass(frozen=True)
class OverviewRules:
    """What a still must show."""

    codes: tuple[CodeKind, ...] = ()
    """Kinds to read; without any, no id is asked for."""
    family: TagFamily = "36h11"
    pattern: re.Pattern[str] | None = None
    """Its group `part` is the part in a code's text, its group `piece` the id of the piece. Without a
    pattern the text is the part."""
    parts: Mapping[str, str] = field(default_factory=dict)
    """That text to the part or another name of a bundle, where they differ."""
    select: bool = False
    """The code on the part selects its bundle."""
    zone: Zone = field(default_factory=Zone)
    """Where the part is."""
    empty: NDArray[np.uint8] | None = None
    """Grey picture of the empty station, uint8 (h, w); without it presence is not checked."""
    present_share: float = PRESENT_SHARE
    """A part changes at least this share of the region."""

    @property
    def is_asking(self) -> bool:
        """True where a press needs a still to be admitted; otherwise stills are only attached."""
        return bool(self.codes) or self.empty is not None

    def look(self, jpeg: bytes, grey: NDArray[np.uint8]) -> OverviewView:
        """Look at a still. grey: the same picture, uint8 (h, w)."""
        seen = np.ascontiguousarray(self.zone.of(grey))
        changed = None if self.empty is None else share_of_change(seen, self.zone.of(self.empty))
        codes = read_codes(seen, self.codes, self.family) if self.codes else ()
        ids = tuple(sorted({one for code in codes if (one := self._piece_in(code))}))
        is_changed = None if changed is None else changed >= self.present_share
        is_present = True if codes else is_changed  # a code that can be read is a part
        return OverviewView(jpeg, None, changed, is_present, codes, ids)

    def _piece_in(self, code: Code) -> str | None:
        """The id of the piece in a code's text, None where the pattern has no group for it, or does not fit."""
        match = None if self.pattern is None else self.pattern.fullmatch(code.text)
        return None if match is None else match.groupdict().get("piece")

    def part_in(self, code: Code) -> str | None:
        """The part that a code names, None where its text does not fit the pattern."""
        text = code.text
        if self.pattern is not None:
            match = self.pattern.fullmatch(text)
            if match is None:
                return None
            text = match["part"] or ""
        return self.parts.get(text, text)

    def refusal(self, view: OverviewView, selected: PartPosition, named_by: NamedBy) -> Rejection | None:
        """Say why a press is not admitted, or None. selected: what the bundle in use inspects."""
        if not self.is_asking:
            return None
        if view.fault is not None:
            text = Sentence(f"the part was not seen before the press: {view.fault}")
            return Rejection(Reason.NO_OVERVIEW, text)
        if view.is_present is False and view.changed is not None:
            changed, present_share = score_texts(view.changed, self.present_share, 1, "%")
            text = Sentence(
                f"{changed} of the overview differs from the empty station, a part changes at least "
                f"{present_share}; place the part, then press"
            )
            return Rejection(Reason.NO_PART, text)
        return self._other_part(view, selected, named_by) if self.codes else None

    def choose_position(self, view: OverviewView, named_by: NamedBy) -> PartPosition | None:
        """Find the one position that every code in view names; None where they name none, several or different ones."""
        named = self._find_positions(view, named_by)
        return next(iter(named)) if len(named) == 1 else None

    def _find_positions(self, view: OverviewView, named_by: NamedBy) -> frozenset[PartPosition]:
        """Find the positions that every code in view names."""
        parts = [self.part_in(code) for code in view.codes]
        each = [frozenset() if part is None else frozenset(named_by(part)) for part in parts]
        return frozenset.intersection(*each) if each else frozenset()

    def _other_part(self, view: OverviewView, selected: PartPosition, named_by: NamedBy) -> Rejection | None:
        if not view.codes:
            kinds = " or ".join(self.codes)
            text = Sentence(
                f"no {kinds} code can be read on the part; turn it to the overview camera, clean it, check the "
                "light"
            )
            return Rejection(Reason.NO_PART_ID, text)
        named = self._find_positions(view, named_by)
        if selected in named:
            return None
        read = ", ".join(f"'{code.text}' ({code.kind})" for code in view.codes)
        if len({self.part_in(code) for code in view.codes}) > 1 and not named:
            text = Sentence(
                f"codes of several parts are seen: {read}; leave one part in view, or narrow overview.region"
            )
            return Rejection(Reason.NO_PART_ID, text)
        what = self._meaning(self.part_in(view.codes[0]), named)
        text = Sentence(
            f"the code {read}, which {what}, the bundle in use is for {selected}; press that part, or select the "
            "other bundle"
        )
        return Rejection(Reason.OTHER_PART, text)

    @staticmethod
    def _meaning(part: str | None, named: Collection[PartPosition]) -> str:
        if part is None:
            return Sentence("fits no overview.part_pattern")
        if not named:
            return Sentence(f"is part '{part}', for which this station has no bundle")
        return Sentence(f"is of {' and '.join(sorted(map(str, named)))}")
