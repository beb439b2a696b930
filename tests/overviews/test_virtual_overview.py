"""The drawn overview camera: its codes can be read."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from edge.clock import ManualClock
from edge.core.overview.rules import read_codes, share_of_change
from edge.core.overview.view import Code
from plugins.overviews.virtual_overview import VirtualOverviewOptions, plugin


def drawn(number: int, **options: object) -> list[NDArray[np.uint8]]:
    camera = plugin.open(VirtualOverviewOptions.model_validate(options), ManualClock())
    payloads = [np.frombuffer(camera.read(0).payload, np.uint8) for _ in range(number)]
    return [np.asarray(cv2.imdecode(one, cv2.IMREAD_GRAYSCALE), np.uint8) for one in payloads]


@pytest.mark.parametrize(("kind", "text"), [("qr", "PZ0;0042"), ("apriltag", "586")])
def test_its_code_is_read(kind: str, text: str) -> None:
    (still,) = drawn(1, parts=[text], kind=kind)

    assert read_codes(still, ["qr", "apriltag"]) == (Code(kind, text),)  # type: ignore[arg-type]


def test_parts_come_in_order_and_again_from_the_start() -> None:
    """An empty text is the empty table, which differs from one with a part."""
    first, empty, again = drawn(3, parts=["A", ""])

    assert [code.text for code in read_codes(again, ["qr"])] == ["A"]
    assert read_codes(empty, ["qr"]) == ()
    assert share_of_change(first, empty) > 0.1 > share_of_change(drawn(4, parts=["A", ""])[3], empty)


@pytest.mark.parametrize("parts", [[], ["587"], ["-1"], ["x"]])
def test_a_tag_is_a_number_of_its_family(parts: list[str]) -> None:
    with pytest.raises(ValidationError):
        VirtualOverviewOptions(parts=parts, kind="apriltag")
