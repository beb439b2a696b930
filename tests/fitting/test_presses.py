"""Nominal presses from recordings and pictures: frames as in the gateway, and a sentence for the rest."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.fitting.fit_again import _left_out_before
from calibration.fitting.presses.nominal_presses import MAX_NO_CONTACT, NominalPresses, read_presses
from edge.core.errors import DatasetError, FitError, RecordingError
from edge.core.imaging.image_bytes import with_comment
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.recording.format import RecordingHeader, RecordingWriter

PROFILE = SensorProfile("test", (160, 120), (0.0, 0.0), (160, 120), 1, 4.0)
REGION = Region(24, 12, 96, 96)
FRAME_NS = 50_000_000


def gel(seed: int, centre: tuple[int, int] | None = None, radius: int = 18) -> bytes:
    """A PNG of the free gel, or of a ball pressed at (x, y): lit from one side, 60 levels either way."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:120, :160].astype(np.float64)
    picture = np.repeat((110 + rows / 6 + columns / 8)[..., None], 3, axis=2)
    if centre is not None:
        slope = (columns - centre[0]) / radius
        inside = (columns - centre[0]) ** 2 + (rows - centre[1]) ** 2 < radius**2
        picture += np.where(inside, 60 * np.sign(slope + 1e-9), 0)[..., None]
    noisy = np.clip(picture + rng.normal(0, 1.0, picture.shape), 0, 255)
    return bytes(cv2.imencode(".png", noisy.astype(np.uint8))[1])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three presses at known places, each half a second long, with a second of free gel around them."""
    folder = tmp_path_factory.mktemp("recordings") / "three"
    header = RecordingHeader("mock", "TEST", (160, 120), 20.0, "test")
    free, pressed = [gel(k) for k in range(4)], [gel(9, (70 + 10 * k, 60)) for k in range(3)]
    frames = [(free[k % 4], None) for k in range(30)]
    for press in range(3):
        frames += [(pressed[press], {"specimen": press // 2})] * 12
        frames += [(free[k % 4], None) for k in range(20)]
    with RecordingWriter(folder, header) as writer:
        for number, (payload, label) in enumerate(frames):
            writer.add(with_comment(payload, str(number)), number * FRAME_NS, label)
    return folder


@pytest.fixture(scope="module")
def recorded(recording: Path) -> NominalPresses:
    return read_presses([recording], PROFILE, REGION)


def test_a_recording_gives_one_frame_per_press(recorded: NominalPresses) -> None:
    """Three presses, three settled frames with their places and specimens, and the free gel before them, whose mean is
    kept for the start of the gateway."""
    assert recorded.frames.shape == (3, 96, 96, 3)
    assert recorded.specimens == ("0", "0", "1")
    assert recorded.faults == ()
    assert [round(t.x * 160) for t in recorded.touches] == pytest.approx([70, 80, 90], abs=2)
    assert recorded.no_contact is not None
    assert 1 <= len(recorded.no_contact) <= MAX_NO_CONTACT
    assert recorded.names[0].startswith("three#")
    assert recorded.free_view is not None
    assert recorded.free_view.shape == (120, 160, 3)
    assert np.abs(recorded.free_view.mean() - 110 - 10 - 10) < 3


def test_touched_is_the_union_of_the_presses_with_a_margin(recorded: NominalPresses) -> None:
    """All three balls are inside, the region's corner is not, and the margin is a millimetre (4 pixels here)."""
    assert recorded.touched is not None
    assert recorded.touched[60 - 12, [70 - 24, 80 - 24, 90 - 24]].all()
    assert not recorded.touched[0, 0]
    assert recorded.touched[48, 90 + 18 + 2 - 24]


def png(rgb: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", rgb)[1])


def write(folder: Path, name: str, payload: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_bytes(payload)
    return folder


def test_pictures_are_presses(tmp_path: Path) -> None:
    """A folder's pictures in the order of their names, cut to the region; without a free gel no touch is known."""
    for k in (1, 0):
        write(tmp_path / "good", f"bolt_crest_s00{k}_p00.png", gel(k, (80, 60)))
    presses = read_presses([tmp_path / "good"], PROFILE, REGION)
    assert presses.names == ("good/bolt_crest_s000_p00.png", "good/bolt_crest_s001_p00.png")
    assert presses.specimens == ("000", "001")
    assert presses.touches == ()
    expected = cv2.imdecode(np.frombuffer(gel(0, (80, 60)), np.uint8), cv2.IMREAD_COLOR)[12:108, 24:120, ::-1]
    np.testing.assert_array_equal(presses.frames[0], expected)


def test_with_a_picture_of_the_free_gel_the_touch_is_known(tmp_path: Path) -> None:
    """The same arithmetic as the gateway's contact detection."""
    write(tmp_path / "good", "a.png", gel(1, (80, 60)))
    write(tmp_path / "free", "b.png", gel(2))
    presses = read_presses([tmp_path / "good"], PROFILE, REGION, no_contact=[tmp_path / "free"])
    assert presses.no_contact is not None
    assert (presses.touches[0].x * 160, presses.touches[0].y * 120) == pytest.approx((80, 60), abs=2)


def test_every_picture_at_fault_is_named_at_once(tmp_path: Path) -> None:
    """Wrong size, cut short, not a picture, black: one report."""
    folder = write(tmp_path / "good", "sound.png", gel(1))
    write(folder, "small.png", png(np.zeros((10, 20, 3), np.uint8)))
    write(folder, "cut.png", gel(1)[:-40])
    write(folder, "text.png", b"not a picture")
    write(folder, "black.png", png(np.zeros((120, 160, 3), np.uint8)))
    with pytest.raises(DatasetError, match="4 of 5 pictures") as caught:
        read_presses([folder], PROFILE, REGION)
    said = (
        "small.png: is 20x10",
        "cut.png: ends early",
        "text.png: is not a picture",
        "black.png: is black: its mean level is 0",
    )
    assert all(words in str(caught.value) for words in said)


def test_what_all_pictures_have_in_common_is_one_sentence(tmp_path: Path) -> None:
    """Pictures of another camera: a line for each would hide what to do."""
    for name in ("a.png", "b.png", "c.png"):
        folder = write(tmp_path / "good", name, png(np.full((10, 20, 3), 77, np.uint8)))
    with pytest.raises(
        DatasetError, match=r"^none of the 3 pictures can be used; each is 20x10, [^\n]*resizing$"
    ):
        read_presses([folder], PROFILE, REGION)


def test_other_sizes_are_scaled_only_when_asked(tmp_path: Path) -> None:
    """A picture of another tool can be used with an option; a portrait loses its upper and lower quarter."""
    tall = np.zeros((160, 120, 3), np.uint8)
    tall[35:125] = 77
    folder = write(tmp_path / "good", "big.png", png(np.full((240, 320, 3), 77, np.uint8)))
    write(folder, "tall.png", png(tall))
    with pytest.raises(
        DatasetError, match=r"big\.png: .*allow resizing\n.*tall\.png: .*turn it by a quarter"
    ):
        read_presses([folder], PROFILE, REGION)
    assert (read_presses([folder], PROFILE, REGION, resize=True).frames == 77).all()


def test_no_source_with_a_press_is_a_sentence(tmp_path: Path) -> None:
    """An empty folder, a missing path, no source, and a recording of the free gel alone."""
    (tmp_path / "empty").mkdir()
    with RecordingWriter(tmp_path / "free", RecordingHeader("mock", "T", (160, 120), 20.0)) as writer:
        for k in range(30):
            writer.add(gel(k), k * FRAME_NS)
    for sources, sentence in (
        (["empty"], "neither a recording nor a folder with pictures"),
        (["missing"], "nothing at"),
        ([], "no press was found"),
        (["free"], "no press was found"),
    ):
        with pytest.raises(FitError, match=sentence):
            read_presses([tmp_path / name for name in sources], PROFILE, REGION)


def test_a_name_that_no_manifest_can_hold_is_a_sentence(tmp_path: Path) -> None:
    """Bytes that are no UTF-8, as of a card that another system has written."""
    folder = write(
        tmp_path / "good", os.fsdecode(b"press\xff.png"), png(np.full((120, 160, 3), 77, np.uint8))
    )
    with pytest.raises(FitError, match=r"press\\udcff.png' cannot be printed; rename the file"):
        read_presses([folder], PROFILE, REGION)


def test_a_recording_with_a_lost_frame_is_refused(recording: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(recording, tmp_path / "copy"))
    next((copy / "frames").iterdir()).unlink()
    with pytest.raises(RecordingError, match="lacks 1 of its"):
        read_presses([copy], PROFILE, REGION)


def test_what_is_missing_of_a_recording_is_said(recording: Path, tmp_path: Path) -> None:
    """A frame that cannot be read, an index that ends within a line, and labels of another number of presses."""
    copy = Path(shutil.copytree(recording, tmp_path / "copy"))
    (copy / "frames" / "000005.png").write_bytes(b"")
    index = (copy / "index.jsonl").read_text()
    (copy / "index.jsonl").write_text(index.replace('{"specimen": ', '{"press": ')[:-9])
    presses = read_presses([copy], PROFILE, REGION)

    cut, unread, labels = presses.faults
    assert cut == "recording copy ends within a line of its index: what came later is not learnt"
    assert unread.startswith("1 of 125 frames of recording copy cannot be read; the first: frame 5 ")
    assert labels == "recording copy has labels of 2 presses, and 3 were found in it"


def test_a_recording_of_another_size_names_the_reason(recording: Path) -> None:
    """Every frame was refused for its size: the sentence has this reason."""
    camera = SensorProfile("mini_lr", (3280, 2464), (0.0, 0.0), (320, 240), 4, 15.77)
    with pytest.raises(
        FitError, match=r"all \d+ frames of .*three were refused; .*160x120.*expects 3280x2464"
    ):
        read_presses([recording], camera, Region(0, 0, 320, 240))


def test_the_frames_of_a_recording_are_no_pictures_of_presses(recording: Path) -> None:
    """Most of them show the free gel."""
    with pytest.raises(FitError, match=f"free gel among them; name the recording, {recording}, in which"):
        read_presses([recording / "frames"], PROFILE, REGION)


def test_a_pattern_chooses_files_in_folders_below(tmp_path: Path) -> None:
    """A folder for each press; the picture of the free gel next to them is not a press."""
    write(tmp_path / "set", "background.png", gel(0))
    for k in range(3):
        write(tmp_path / "set" / str(k), "press.png", gel(k, (80, 60)))
        write(tmp_path / "set" / str(k), "plot.png", gel(k))
    with pytest.raises(FitError, match=r"one picture directly inside, background\.png, and 6 in"):
        read_presses([tmp_path / "set"], PROFILE, REGION)
    with pytest.raises(
        FitError, match=r"directly inside; choose with --pattern, such as --pattern '\*/\*/plot\.p"
    ):
        read_presses([tmp_path], PROFILE, REGION)
    (tmp_path / "days").mkdir()
    write(tmp_path / "days" / "monday", "1.png", gel(0))
    write(tmp_path / "days" / "tuesday", "2.png", gel(0))
    with pytest.raises(FitError, match=r"directly inside; name the folder that holds them, .*/days/monday$"):
        read_presses([tmp_path / "days"], PROFILE, REGION)
    free = [tmp_path / "set/background.png"]
    presses, everything = (
        read_presses([tmp_path / "set"], PROFILE, REGION, pattern=pattern, no_contact=free)
        for pattern in ("*/press.png", "**/*")
    )
    assert presses.names == ("0/press.png", "1/press.png", "2/press.png")
    assert len(everything) == 6


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """Four presses beside each other."""
    for k in range(4):
        write(tmp_path / "good", f"{k}.png", gel(k, (50 + 15 * k, 60)))
    return tmp_path / "good"


def test_the_free_gel_is_known_without_a_picture_of_it(good: Path, tmp_path: Path) -> None:
    """Estimated from four presses of one place or of any; a picture of another light, or of a touch, is replaced, and
    both are said. An estimate may have part of what touches: by it methods learn every place."""
    write(tmp_path / "other", "free.png", other_light(gel(9)))
    write(tmp_path / "own", "free.png", gel(9))
    write(tmp_path / "touched", "free.png", gel(9, (120, 25)))
    none, wrong, right, pressed = (
        read_presses([good], PROFILE, REGION, no_contact=[tmp_path / name for name in names])
        for names in ([], ["other"], ["own"], ["touched"])
    )
    assert (none.estimated != "", none.touched) == (True, None)
    assert [touch.x * 160 for touch in none.touches] == pytest.approx([50, 65, 80, 95], abs=2)
    assert none.touches == wrong.touches
    assert none.faults == right.faults == ()
    assert none.facts["free_gel"].startswith("estimated from 4 presses")
    assert "differs by" in wrong.faults[0]
    assert "take one under the light of the presses" in wrong.faults[0]
    assert right.facts == {}
    assert "as a touch does: something touches the gel in it, or another light" in pressed.faults[0]
    few = read_presses([good / f"{k}.png" for k in range(3)], PROFILE, REGION)
    assert few.no_contact is None


def test_a_part_that_fills_the_view_is_no_other_light(tmp_path: Path) -> None:
    """Grooves over the whole view: the given picture is right, and nothing is said of it."""
    free = cv2.imdecode(np.frombuffer(gel(9), np.uint8), cv2.IMREAD_COLOR)
    assert free is not None
    for k in range(4):
        grooves = 40 * np.sin((np.arange(160) + 3 * k) / 2)[None, :, None] + free
        write(tmp_path / "good", f"{k}.png", png(np.clip(grooves, 0, 255).astype(np.uint8)))
    write(tmp_path / "own", "free.png", gel(8))
    presses = read_presses([tmp_path / "good"], PROFILE, REGION, no_contact=[tmp_path / "own"])
    assert presses.faults == ()
    assert min(touch.area for touch in presses.touches) > 0.8
    guessed = read_presses([tmp_path / "good"], PROFILE, REGION)
    assert (
        "rim not seen: no contact is known by it; give a picture of it with --no-contact" in guessed.faults[0]
    )
    assert guessed.touches == ()
    assert guessed.no_contact is None  # nothing is registered, rendered or proven with it


def other_light(payload: bytes) -> bytes:
    """The same picture, reddish towards one side."""
    across = 50 * np.clip(np.linspace(-1, 1, 160), 0, 1)[None, :, None]
    lit = cv2.imdecode(np.frombuffer(payload, np.uint8), cv2.IMREAD_COLOR) + across * [1.0, 0.2, -0.8]
    return png(np.clip(lit, 0, 255).astype(np.uint8))


def test_a_gently_curved_part_at_one_place_is_no_other_light(tmp_path: Path) -> None:
    """The estimate takes a lying cylinder for light: the right picture is kept. Without it the doubt is said."""
    down = np.linspace(-1, 1, 120)[:, None, None]
    for k in range(4):
        deep = (90 + 8 * k) * (down - down**3)
        curved = cv2.imdecode(np.frombuffer(gel(k), np.uint8), cv2.IMREAD_COLOR) + deep
        write(tmp_path / "good", f"{k}.png", png(np.clip(curved, 0, 255).astype(np.uint8)))
    write(tmp_path / "own", "free.png", gel(9))
    presses = read_presses([tmp_path / "good"], PROFILE, REGION, no_contact=[tmp_path / "own"])
    assert presses.estimated == ""
    assert min(touch.area for touch in presses.touches) > 0.4
    assert all("a smooth part that always lies at one place looks the same" in one for one in presses.faults)
    guessed = read_presses([tmp_path / "good"], PROFILE, REGION)
    assert guessed.no_contact is None
    assert "it may hold the part: no contact is known by it" in guessed.faults[0]


def test_contacts_by_a_gel_in_doubt_are_kept_for_a_warning(tmp_path: Path) -> None:
    """Balls anywhere on a marker gel: their places are guessed, and known to nothing else."""
    rows, columns = np.mgrid[:120, :160]
    dots = ((rows % 20 < 6) & (columns % 20 < 6))[..., None]
    for k in range(6):
        ball = cv2.imdecode(
            np.frombuffer(gel(k, (30 + 20 * k, 40 + 15 * (k % 3))), np.uint8), cv2.IMREAD_COLOR
        )
        write(tmp_path / "good", f"{k}.png", png(np.where(dots, 20, ball).astype(np.uint8)))
    presses = read_presses([tmp_path / "good"], PROFILE, REGION)
    assert "dots or parts all over it" in presses.faults[0]
    assert presses.touches == ()
    assert [touch.x * 160 for touch in presses.guessed] == pytest.approx([30, 50, 70, 90, 110, 130], abs=8)


def test_foreign_pictures_of_the_free_gel_are_named(good: Path, tmp_path: Path) -> None:
    """One among right ones is left out; of several it is said how the first differs."""
    write(tmp_path / "free", "a.png", other_light(gel(9)))
    write(tmp_path / "free", "b.png", gel(8))
    presses = read_presses([good], PROFILE, REGION, no_contact=[tmp_path / "free"])
    (said,) = presses.faults
    assert said.startswith("1 of 2 pictures of the free gel ('free/a.png') differs by")
    assert said.endswith("left out")
    assert presses.no_contact is not None
    assert len(presses.no_contact) == 1
    write(tmp_path / "free", "b.png", other_light(gel(9)))
    (said,) = read_presses([good], PROFILE, REGION, no_contact=[tmp_path / "free"]).faults
    assert "2 of 2 pictures of the free gel ('free/a.png', 'free/b.png'): the first differs by" in said


def test_a_foreign_picture_beside_a_recording_is_left_out(recording: Path, tmp_path: Path) -> None:
    """The recording shows the free gel itself."""
    write(tmp_path / "free", "a.png", other_light(gel(9)))
    write(tmp_path / "own", "a.png", gel(9))
    foreign, own, none = (
        read_presses([recording], PROFILE, REGION, no_contact=[tmp_path / name for name in names])
        for names in (["free"], ["own"], [])
    )
    (said,) = foreign.faults
    assert said.startswith("the picture of the free gel ('free/a.png') differs by")
    assert said.endswith("left out")
    assert own.faults == ()
    assert foreign.no_contact is not None
    np.testing.assert_array_equal(foreign.no_contact, none.no_contact)


def test_the_free_gel_of_a_recording_serves_pictures_beside_it(recording: Path, tmp_path: Path) -> None:
    """Of another light these are named, and do not replace it."""
    alone = read_presses([recording], PROFILE, REGION)
    for k in range(4):
        write(tmp_path / "own", f"{k}.png", gel(k, (52 + 15 * k, 60)))
        write(tmp_path / "foreign", f"{k}.png", other_light(gel(k, (52 + 15 * k, 60))))
    own, foreign = (
        read_presses([recording, tmp_path / name], PROFILE, REGION) for name in ("own", "foreign")
    )
    for presses in (own, foreign):
        assert presses.estimated == ""
        np.testing.assert_array_equal(presses.no_contact, alone.no_contact)  # type: ignore[arg-type]
    assert [touch.x * 160 for touch in own.touches[3:]] == pytest.approx([52, 67, 82, 97], abs=2)
    assert own.faults == ()
    assert any("beside the presses of the pictures" in fault for fault in foreign.faults)


def test_with_three_presses_a_foreign_picture_is_suspected(tmp_path: Path) -> None:
    """Too few for an estimate: the contacts alone tell."""
    for k in range(3):
        write(tmp_path / "good", f"{k}.png", gel(k, (52 + 15 * k, 60), 9))
    write(tmp_path / "free", "a.png", other_light(gel(9)))
    write(tmp_path / "own", "a.png", gel(9))
    foreign, own = (
        read_presses([tmp_path / "good"], PROFILE, REGION, no_contact=[tmp_path / name])
        for name in ("free", "own")
    )
    assert "most likely of another light than the presses" in foreign.faults[0]
    (unchecked,) = own.faults
    assert "is of the light of the presses cannot be checked with 3 presses: look at it" in unchecked


def test_a_recording_given_twice_has_the_pieces_that_it_has_once(recording: Path, tmp_path: Path) -> None:
    """By its name, or as a copy of its folder, whose presses have other names: no press is a piece of its own twice."""
    plain = Path(shutil.copytree(recording, tmp_path / "plain"))
    (plain / "index.jsonl").write_text((plain / "index.jsonl").read_text().replace("specimen", "other"))
    copy = Path(shutil.copytree(plain, tmp_path / "copy"))
    once, twice, copied = (
        read_presses(given, PROFILE, REGION).specimens for given in ([plain], [plain, plain], [plain, copy])
    )
    assert once == (None, None, None)
    assert twice == copied == (*read_presses([plain], PROFILE, REGION).names,) * 2
    assert read_presses([plain, recording], PROFILE, REGION).specimens == ("0", "0", "1") * 2


def test_pictures_of_folders_that_are_named_alike_have_names_of_their_own(tmp_path: Path) -> None:
    """Each can be left out alone, and each picture of the free gel counts."""
    for k, name in enumerate("ab"):
        for number in range(2):
            (tmp_path / name).mkdir(exist_ok=True)
            write(tmp_path / name / "rgb", f"p{number}.png", gel(k, (60 + 20 * k, 50 + 20 * number)))
        write(tmp_path / name / "free", "f.png", gel(8 + k))
    given, free = ([tmp_path / name / folder for name in "ab"] for folder in ("rgb", "free"))

    presses = read_presses(given, PROFILE, REGION, no_contact=free, leave_out=["b/rgb/p1.png"])

    assert presses.names == ("a/rgb/p0.png", "a/rgb/p1.png", "b/rgb/p0.png")
    assert presses.no_contact is not None
    assert len(presses.no_contact) == 2
    assert _left_out_before([given[1]], presses.left_out, None) == ["rgb/p1.png"]
    assert _left_out_before([given[0]], presses.left_out, None) == []
    with pytest.raises(
        FitError, match=r"several presses are named 'rgb/p1.png'.*: a/rgb/p1.png, b/rgb/p1.png"
    ):
        read_presses(given, PROFILE, REGION, leave_out=["rgb/p1.png"])
    twice = read_presses([given[0], given[0]], PROFILE, REGION)
    assert twice.names == ("rgb/p0.png", "rgb/p1.png") * 2


def test_presses_of_recordings_that_are_named_alike_have_names_of_their_own(
    recording: Path, tmp_path: Path
) -> None:
    """What was left out of one is left out again, whatever else is given."""
    one, other = (Path(shutil.copytree(recording, tmp_path / name / "three")) for name in "ab")
    both = read_presses([one, other], PROFILE, REGION)
    assert [name.partition("#")[0] for name in both.names] == ["a/three"] * 3 + ["b/three"] * 3
    assert _left_out_before([other], [both.names[4], "rgb/p1.png"], None) == [
        both.names[4].removeprefix("b/")
    ]
    assert _left_out_before([other], [both.names[1]], None) == []


def test_pictures_in_folders_below_are_said(good: Path, tmp_path: Path) -> None:
    """Those of another folder that is given, and of the free gel, are read."""
    write(good / "monday", "1.png", gel(9, (110, 60)))
    write(good / "free", "1.png", gel(0))
    free = [good / "free"]
    (said,) = read_presses([good], PROFILE, REGION, no_contact=free).faults
    assert said.startswith(
        f"pictures in folders below {good} are not read, such as {good}/monday/1.png: name"
    )
    assert read_presses([good, good / "monday"], PROFILE, REGION, no_contact=free).faults == ()


def test_further_pages_of_a_picture_are_said(tmp_path: Path) -> None:
    """A TIFF of three presses is one press, and a scan of one page is nothing to speak of."""
    pages = [
        cv2.imdecode(np.frombuffer(gel(k, (60 + 20 * k, 60)), np.uint8), cv2.IMREAD_COLOR) for k in range(3)
    ]
    (tmp_path / "good").mkdir()
    cv2.imwritemulti(str(tmp_path / "good" / "a.tif"), pages)
    cv2.imwrite(str(tmp_path / "good" / "b.tif"), pages[1])
    (said,) = read_presses([tmp_path / "good"], PROFILE, REGION).faults
    assert said.startswith("1 of 2 pictures have further pages, which are not read (")
    assert "good/a.tif' has 3): save each page as a picture of its own" in said
