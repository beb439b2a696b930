"""A calibrated station says how large and how deep a deviation is, after its result; or why it does not."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import gelgate
from lit_surface import calibration, other_gel
from station import station_config
from stepped_station import SteppedStation

from edge.core.heights.calibration import CELLS, HeightCalibration
from edge.core.heights.height_map import free_picture
from edge.core.imaging.sensor_check import colour_cells
from edge.core.press import Again, Press
from edge.core.verdict import Kind, Verdict
from edge.features.deviations import Deviations
from edge.heights.files import write_calibration
from edge.model.bundle import Bundle
from edge.pictures.image_file import texts
from edge.store.history import HistoryQuery, read_history
from edge.store.outbox import Outbox


def of_gel(bundle: Path) -> HeightCalibration:
    """A calibration whose gel is that of the recordings; its heights are of no real unit."""
    view = np.asarray(Bundle.load(bundle).free_view, np.float32)
    return replace(calibration(), free_levels=colour_cells(free_picture(view), CELLS))


def configure(folder: Path, recording: Path, bundle: Path, made: HeightCalibration | None) -> Path:
    (folder / "gel.toml").write_text("" if made is None else write_calibration(made))
    return station_config(folder, recording, bundle, tables=f"[gel]\nheights = '{folder / 'gel.toml'}'")


def sent(folder: Path) -> dict[str, bytes]:
    """Every message that waits, in order."""
    with Outbox(folder / "gelgate.db") as opened:
        return {row.message.topic: row.message.payload for row in opened.pending("mqtt", 100)}


@pytest.fixture
def played(tmp_path: Path, recording: Path, bundle: Path) -> Iterator[SteppedStation]:
    with SteppedStation(configure(tmp_path, recording, bundle, of_gel(bundle))) as station:
        station.play()
        yield station


def test_what_was_measured_follows_the_result(played: SteppedStation, tmp_path: Path) -> None:
    """Before the pictures, in their texts, and in the history; a pass is not measured. From the archive it is measured
    and drawn again as it was, which a start does after a stop."""
    topics = [result.deviations_topic for result in played.results]
    dented = played.results[1]
    name = f"deviations/{dented.press_id}"
    assert topics == [None, name, None]
    messages = sent(tmp_path)
    order = list(messages)
    assert order.index(name) + 1 == order.index(f"scoremap/{dented.press_id}")

    said = json.loads(messages[name])
    assert (said["press_id"], said["calibration"], said["reason"]) == (dented.press_id, "lit", None)
    assert len(said["deviations"]) == len(dented.defects or [])
    first = said["deviations"][0]
    assert first["depth_u95_mm"] > 0
    shown = texts(messages[f"heatmap/{dented.press_id}"]).get("deviation", "")
    assert (first["depth_mm"] is not None) == shown.startswith("depth ")
    again = played.parts.pictures._draw_again(dented.press_id)
    assert again.deviations is not None
    assert again.deviations.encode() == messages[name]
    assert again.sheet == messages[f"heatmap/{dented.press_id}"]
    row = list(read_history(tmp_path / "gelgate.db", HistoryQuery()))[1]
    assert (row.depth_mm, row.depth_u95_mm, row.size_mm, row.size_u95_mm) == tuple(
        first[key] for key in ("depth_mm", "depth_u95_mm", "size_mm", "size_u95_mm")
    )


def test_another_gel_is_not_measured(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """The message says so, and the history has no number."""
    with SteppedStation(configure(tmp_path, recording, bundle, other_gel())) as station:
        station.play()
        said = json.loads(sent(tmp_path)[f"deviations/{station.results[1].press_id}"])
    assert "another gel, sensor or crop" in said["reason"]
    assert said["deviations"] == []
    assert list(read_history(tmp_path / "gelgate.db", HistoryQuery()))[1].depth_u95_mm is None


def test_without_a_calibration_a_size_is_in_pixels(station: SteppedStation, tmp_path: Path) -> None:
    station.play()
    dented = station.results[1]
    assert dented.deviations_topic is None
    assert dented.defects
    assert 1 < (dented.defects[0].size_px or 0) <= np.hypot(*dented.defects[0].box_px[2:])
    assert not any(topic.startswith("deviations/") for topic in sent(tmp_path))


def test_what_decided_two_presses_is_measured(bundle: Path) -> None:
    """The second one lies below the threshold there; its defects are those of the result, none less."""
    meter, opened = Mock(), Bundle.load(bundle)
    limit = opened.manifest.threshold.value
    score_map = np.zeros(opened.manifest.frame, np.float32)
    score_map[40:44, 50:54] = 0.97 * limit
    press = Press(Verdict(Kind.FAIL, 1.02 * limit, limit, 0.0), score_map=score_map)
    again = Again("", is_asked=False, second_of="1", own_score=0.97 * limit, shown_from=0.95 * limit)
    measured = Deviations(meter).draw_again(replace(press, again=again), opened)
    assert measured.measure is not None
    measured.measure()

    (_, defects, _, _), _ = meter.measure.call_args
    assert [one.box_px for one in defects] == [(50, 40, 4, 4)]


def test_a_damaged_calibration_is_a_sentence_at_check(tmp_path: Path, recording: Path, bundle: Path) -> None:
    done = gelgate("check", "-c", configure(tmp_path, recording, bundle, None))
    assert done.code != 0
    assert "gel.toml" in done.out + done.err


def test_an_archived_press_is_measured_by_its_id(played: SteppedStation, tmp_path: Path) -> None:
    """`station heights` takes picture, free gel and calibration from the station."""
    press_id = played.results[1].press_id
    words = (press_id[:20], "-c", tmp_path / "gelgate.toml", "-o", tmp_path / "press.npz")
    done = gelgate("station", "heights", *words)
    assert done.code == 0, done.err
    with np.load(tmp_path / "press.npz", allow_pickle=False) as read:
        assert str(read["source"]) == press_id
        assert np.isfinite(read["heights_mm"]).all()
        assert read["touched"].any()
