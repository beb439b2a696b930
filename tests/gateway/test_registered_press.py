"""A press anywhere through the gateway: its verdict, what its result states of the pose, and its rejection."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import turned_parts as parts
from numpy.typing import NDArray
from registered_bundle import registered

from edge.clock import SystemClock
from edge.core.contact.mask import Touch
from edge.core.imaging.frames import CameraFrame
from edge.core.press import Press
from edge.core.registration.pose import Pose
from edge.core.sink_context import Place
from edge.gateway.recorder import Recorder
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.store.press_store import Store
from edge.store.ulid import new_ulid


@pytest.fixture(scope="module")
def inspector() -> Inspector:
    return Inspector(Scorer(registered().bundle(), 1), SystemClock())


def _inspected(inspector: Inspector, rgb: NDArray[np.uint8]) -> Press:
    payload = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
    return inspector.inspect(CameraFrame(payload.tobytes(), 0, 0, True), Touch(0.1))


def _published(tmp_path: Path, inspector: Inspector, inspection: Press) -> dict[str, Any]:
    """The fields of the result as a subscriber reads them."""
    store = Store(tmp_path / "presses.db")
    try:
        recorder = Recorder(store, "SIM1", Place("site", "line", "station"), SystemClock())
        press = replace(inspection, press_id=new_ulid(0), bundle_id=inspector.bundle.digest)
        return dict(json.loads(recorder.record(recorder.prepare(press, inspector)).result.encode()))
    finally:
        store.close()


def test_a_press_anywhere_passes_and_its_result_states_where_it_lay(
    tmp_path: Path, inspector: Inspector
) -> None:
    """Shift and turn between two presses are those that the formula gave, in mm and degrees."""
    here, there = Pose(-4.0, 6.0, 0.5), Pose(8.0, 1.0, 1.25)
    found = [_inspected(inspector, parts.press(parts.BLOCK, pose, seed=9)) for pose in (here, there)]
    poses = [_published(tmp_path, inspector, one)["pose"] for one in found]

    assert [one.word for one in found] == ["pass", "pass"]
    assert poses[1]["turn_deg"] - poses[0]["turn_deg"] == pytest.approx(np.degrees(0.75), abs=0.5)
    assert poses[0]["match"] > 0.9
    assert 0 < poses[0]["x_sd_mm"] < 0.1


def test_the_share_of_the_part_that_left_the_field_is_published(tmp_path: Path, inspector: Inspector) -> None:
    """A part at the rim states what was not judged; one in the middle states nothing unseen."""
    presses = (parts.press(parts.BLOCK, Pose(x)) for x in (0.0, 30.0))
    results = [_published(tmp_path, inspector, _inspected(inspector, rgb)) for rgb in presses]
    middle, rim = (result["pose"]["unseen_share"] for result in results)

    assert middle < 0.05 < rim


def test_a_press_whose_pose_is_not_found_is_rejected(tmp_path: Path, inspector: Inspector) -> None:
    """Another part is no pass and no fail: the reason and a sentence are published."""
    inspection = _inspected(inspector, parts.press(parts.OTHER, Pose(3.0, -2.0, 0.4)))
    result = _published(tmp_path, inspector, inspection)

    assert inspection.word == "rejected"
    assert result["reason"].startswith("no_pose: the part is not recognised")
    assert result["pose"] is None


def test_the_time_of_registration_is_published(inspector: Inspector) -> None:
    """It is a stage of its own next to trunk and head."""
    found = _inspected(inspector, parts.press(parts.BLOCK, Pose()))

    assert list(found.latency_ms) == ["decode", "registration", "trunk", "head"]


def test_places_that_were_not_judged_are_dark_in_the_picture(tmp_path: Path, inspector: Inspector) -> None:
    """The same press without its registration is drawn brighter."""
    inspection = _inspected(inspector, parts.press(parts.BLOCK, Pose(30.0)))
    store = Store(tmp_path / "presses.db")
    try:
        recorder = Recorder(store, "SIM1", Place("site", "line", "station"), SystemClock())
        pictures = [
            recorder.prepare(replace(inspection, press_id=new_ulid(0), **change), inspector).heatmap_png
            for change in ({}, {"registered": None})
        ]
    finally:
        store.close()
    dark, bright = (cv2.imdecode(np.frombuffer(png or b"", np.uint8), cv2.IMREAD_COLOR) for png in pictures)

    assert dark is not None
    assert bright is not None
    assert float(dark.mean()) < float(bright.mean()) - 1
