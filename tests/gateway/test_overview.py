"""The overview camera of a station: stills with results, and presses that are refused because of the part."""

import json
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from overview_stills import blank, encoded, with_tag
from station import station_config
from stepped_station import SteppedStation

from edge.acquisition import Acquisition, AcquisitionState
from edge.clock import ManualClock
from edge.core.errors import DeviceLost, FrameCorrupt, RecordingEnded
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.image_bytes import picture_size, with_comment
from edge.core.overview.rules import OverviewRules, read_codes
from edge.core.part_position import PartPosition
from edge.core.ports import DeviceIdentity
from edge.core.press import Press, ReferenceLabel
from edge.core.verdict import Kind
from edge.features.overview import WAIT_S, Overview, still_of

SELECTION = Mock(part=PartPosition("PZ0", "pos1"), find_all=lambda name: {PartPosition("PZ0", "pos1")})
IDENTITY = DeviceIdentity("camera", "C1", (320, 240), 5.0)


class ScriptedCamera:
    """Gives these pictures, one for each read; then it ends with the error."""

    identity = IDENTITY

    def __init__(self, clock: ManualClock, payloads: Sequence[bytes], end: Exception) -> None:
        self._clock, self._payloads, self._end = clock, list(payloads), end

    def read(self, deadline_ns: int) -> CameraFrame:
        if not self._payloads:
            raise self._end
        return CameraFrame(self._payloads.pop(0), self._clock.monotonic_ns(), 0)

    def close(self) -> None: ...


def overview_of(
    clock: ManualClock,
    payloads: Sequence[bytes],
    rules: OverviewRules | None = None,
    end: Exception | None = None,
) -> Overview:
    device = ScriptedCamera(clock, payloads, end or DeviceLost("camera C1 was unplugged"))
    camera = Acquisition(lambda: device, clock, depth=1)
    return Overview(camera, rules or OverviewRules(), SELECTION, clock, max_age_s=2.0, max_side_px=1280)


def station_with_overview(folder: Path, recording: Path, bundle: Path, table: str) -> SteppedStation:
    return SteppedStation(station_config(folder, recording, bundle, tables=f"[overview]\n{table}"))


def play(station: SteppedStation) -> None:
    """Both cameras are read and the loop looks, in turn, to the end."""
    while not station.has_ended:
        station.find(Overview).camera.step()
        station.play(1)
        station.publish()


def test_each_result_has_the_still_of_its_part(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """Three presses, three parts: every result names its code, and its still is a JPEG on the topic of its press, which
    comes before the retained result that names it. A press of another part, or of one without a code, is rejected with
    what was read, not scored, and counts for the gel as any press."""
    table = 'plugin = "virtual_overview"\ncodes = ["qr"]\npart_pattern = "(?P<part>[^;]+);.*"\n'
    table += 'options = { parts = ["PZ0;1", "PZ9;2", ""] }'
    with station_with_overview(tmp_path, recording, bundle, table) as station:
        play(station)
        first, other, none = station.results
        camera = station.find(Overview).camera

    assert camera.status.state is AcquisitionState.CLOSED
    assert [result.part_codes for result in station.results] == [["PZ0;1"], ["PZ9;2"], []]
    assert [result.part_present for result in (first, other)] == [True] * 2
    assert first.verdict is not Kind.REJECTED
    assert [(result.verdict, result.score) for result in (other, none)] == [(Kind.REJECTED, None)] * 2
    assert "part 'PZ9', for which this station has no bundle, the bundle in use is for PZ0" in str(
        other.reason
    )
    assert str(none.reason).startswith("no_part_id: no qr code can be read")
    assert station.reports[-1].gel.presses == 3
    lines = [json.loads(line) for line in (tmp_path / "out/messages.jsonl").read_text().splitlines()]
    topics = [line["topic"] for line in lines]
    for result in station.results:
        assert result.overview_topic == f"overview/{result.press_id}"
        still = (tmp_path / "out" / lines[topics.index(result.overview_topic)]["file"]).read_bytes()
        grey = cv2.imdecode(np.frombuffer(still, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert [code.text for code in read_codes(np.asarray(grey, np.uint8), ["qr"])] == result.part_codes
        named = (n for n, line in enumerate(lines) if line["topic"] == "last")
        assert topics.index(result.overview_topic) < max(
            n for n in named if lines[n]["payload"]["overview_topic"] == result.overview_topic
        )


def test_a_station_without_an_overview_camera_says_nothing_of_it(station: SteppedStation) -> None:
    """Its results have null in these fields."""
    station.play_until(lambda: bool(station.reports))
    (result,) = station.results
    assert (result.overview_topic, result.part_codes, result.part_present) == (None, None, None)


def test_the_part_is_looked_at_when_the_contact_begins(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """A station whose overview camera shows another part before the press rests: the first one was pressed."""
    table = 'plugin = "virtual_overview"\ncodes = ["apriltag"]\nparts = { 1 = "PZ0" }'
    with station_with_overview(tmp_path, recording, bundle, table) as station:
        overview = station.find(Overview)
        device = ScriptedCamera(
            station.clock, [encoded(with_tag(n)) for n in (1, 2)], DeviceLost("unplugged")
        )
        overview.camera = Acquisition(lambda: device, station.clock, depth=1)
        station.play(2)
        overview.camera.step()
        overview.camera.step()
        station.play_until(lambda: station.loop.session.has_contact)
        overview.camera.step()
        station.play_until(lambda: bool(station.reports))

    assert station.results[0].part_codes == ["1"]


def test_the_still_is_the_newest_of_the_moment_when_the_contact_began() -> None:
    """A camera gives more pictures than there are presses: those between are dropped. A picture that comes while the
    sensor covers the part changes nothing."""
    rules = OverviewRules(codes=("apriltag",))
    overview = overview_of(ManualClock(), [encoded(with_tag(n)) for n in (1, 2, 3)], rules)
    for _ in range(3):
        overview.camera.step()
    overview.begin(None)
    overview.camera.step()
    views = [overview.admit(Press()).overview for _ in range(2)]

    assert [[code.text for code in view.codes] for view in views if view] == [["2"], ["3"]]


def test_a_still_serves_two_quick_presses_and_then_is_too_old() -> None:
    """A slow camera's picture counts for max_age_s, not longer: an older one may show another part."""
    clock = ManualClock()
    overview = overview_of(clock, [encoded(blank())])
    overview.camera.step()
    overview.camera.step()
    first = overview.look_at_part()
    clock.sleep(1.9)
    second = overview.look_at_part()
    clock.sleep(0.2)
    overview.camera.step()  # the camera is gone
    third = overview.look_at_part()

    assert first.jpeg == second.jpeg == encoded(blank())
    assert (third.jpeg, third.fault) == (None, "camera C1 was unplugged")


@pytest.mark.parametrize("state", AcquisitionState)
def test_only_a_camera_that_may_soon_give_a_picture_is_waited_for(state: AcquisitionState) -> None:
    """One that is lost holds up no press."""
    camera = Mock(status=Mock(state=state, fault=None))
    camera.next.return_value = None
    may_give = state in (AcquisitionState.CONNECTING, AcquisitionState.STREAMING)
    overview = Overview(camera, OverviewRules(), SELECTION, ManualClock(), max_age_s=2.0, max_side_px=1280)

    assert overview.look_at_part().fault == "the overview camera has given no new picture"
    assert [call.args for call in camera.next.call_args_list] == [(0,), (WAIT_S,)][: 1 + may_give]


def test_a_recording_that_is_over_gives_no_still() -> None:
    """And its end is no end of the station."""
    overview = overview_of(ManualClock(), [], end=RecordingEnded("recording r has ended after 0 frames"))
    overview.start()
    with pytest.raises(RecordingEnded):
        overview.camera.next(20)
    assert overview.look_at_part().fault == "recording r has ended after 0 frames"
    overview.close()


def test_a_small_jpeg_is_published_untouched() -> None:
    """The camera's own bytes; larger ones and PNG become a JPEG of at most that side."""
    small = encoded(with_tag(1))
    png = cv2.imencode(".png", with_tag(1))[1].tobytes()
    large, grey = still_of(CameraFrame(small, 0, 0), 160)

    assert still_of(CameraFrame(small, 0, 0), 320)[0] == small
    assert picture_size(large) == (160, 120)
    assert grey.shape == (120, 160)
    assert picture_size(still_of(CameraFrame(png, 0, 0), 320)[0]) == (320, 240)


def huge() -> bytes:
    """A JPEG whose header says 60000 x 60000."""
    raw = bytearray(encoded(blank()))
    start = raw.index(b"\xff\xc0") + 5
    raw[start : start + 4] = (60000).to_bytes(2, "big") * 2
    return bytes(raw)


@pytest.mark.parametrize(
    ("payload", "word"),
    [
        (b"", "no"),
        (encoded(blank())[:-2], "end marker"),
        (b"\xff\xd8\xff\xd9", "no picture"),
        (huge(), "60000x60000"),
    ],
)
def test_a_broken_still_is_a_fault_and_no_error(payload: bytes, word: str) -> None:
    """The press has no still, and says why."""
    with pytest.raises(FrameCorrupt, match=word):
        still_of(CameraFrame(payload, 0, 7), 1280)


def test_a_camera_that_hangs_is_refused_though_its_bytes_differ() -> None:
    """The same picture with other bytes at the next press: nothing is known of the part; then it works again."""
    clock, still = ManualClock(), encoded(blank())
    pictures = [still, with_comment(still, "2"), with_comment(still, "3"), encoded(blank() + 1)]
    overview = overview_of(clock, pictures)
    faults = []
    overview.camera.step()
    for _ in pictures:
        overview.camera.step()
        faults.append(overview.look_at_part().fault)
    hung = "the overview camera gives one picture again and again"
    assert faults == [None, hung, hung, None]


def test_a_master_piece_needs_no_still() -> None:
    """It is neither looked at nor refused; a press that was not looked at has no fields of it."""
    overview = overview_of(ManualClock(), [], OverviewRules(codes=("qr",)))
    master = Press(label=ReferenceLabel("M1", "pass", 5))
    assert overview.admit(master) is master
    assert overview.fields(master) == {}
