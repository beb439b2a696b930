"""Films become recordings: frames at the film's own times, sizes named, nothing squashed."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import gelgate, ran
from numpy.typing import NDArray

from edge.core.errors import DatasetError, RecordingError
from edge.core.imaging.sensor_profile import cut_in_words, cut_to_aspect
from edge.recording.format import Recording
from edge.recording.from_images import images_in
from edge.recording.from_video import film_of, record_video

FPS = 20.0


def gel(depth: float, size: tuple[int, int], seed: int) -> NDArray[np.uint8]:
    """BGR: the gel, a ball pressed into its middle, and noise."""
    return np.clip(clean(depth, size) + noise(size, seed % 8), 0, 255).astype(np.uint8)


@cache
def noise(size: tuple[int, int], seed: int) -> NDArray[np.float32]:
    return 2 * np.random.default_rng(seed).standard_normal((size[1], size[0], 3), np.float32)


@cache
def clean(depth: float, size: tuple[int, int]) -> NDArray[np.float32]:
    width, height = size
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    radius = max(0.16 * height * depth**0.5, 1e-3)
    u, v = (columns - width / 2) / radius, (rows - height / 2) / radius
    slopes = np.stack([60 * v, 55 * u, -60 * v], axis=-1) * (u * u + v * v <= 1)[..., None] * depth
    level = (100 + 30 * rows / height + 20 * columns / width)[..., None]
    return np.asarray(level + slopes, np.float32)


def written(path: Path, frames: Sequence[NDArray[np.uint8]], fps: float = FPS) -> Path:
    """Write a film of these frames."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def film(path: Path, size: tuple[int, int] = (320, 240), presses: int = 2, fps: float = FPS) -> Path:
    """Two seconds of free gel, then presses of a second with a second between."""
    depths = [0.0] * 40 + ([0.4, 0.8] + [1.0] * 18 + [0.3] + [0.0] * 20) * presses
    return written(path, [gel(depth, size, number) for number, depth in enumerate(depths)], fps)


def test_a_film_that_is_cut_says_so(tmp_path: Path) -> None:
    """The presses at its end are not in the recording."""
    whole = film(tmp_path / "whole.avi", presses=1)
    content, cut = whole.read_bytes(), tmp_path / "cut.avi"
    cut.write_bytes(content[: len(content) // 2])
    said = ran("record", tmp_path / "out", "--from-video", cut)

    assert "frames of cut.avi; it says it has 81: it is cut, or has damaged frames" in said
    assert "it says" not in ran("record", tmp_path / "out2", "--from-video", whole)


def test_frames_keep_the_films_times(tmp_path: Path) -> None:
    """Sizes, rate and times are the file's, and each frame's label says where it comes from."""
    given = film_of(film(tmp_path / "a.avi", fps=12.5))
    assert (given.size, given.fps) == ((320, 240), 12.5)
    count = record_video(tmp_path / "out", given, size=None, product="p", serial="s")
    recording = Recording.open(tmp_path / "out")
    assert count == len(recording) == 40 + 2 * 41
    assert np.diff(recording.times_ns()) == pytest.approx(80_000_000, abs=1_000_000)
    assert recording.labels()[3] == {"source": "a.avi", "frame": 3}
    assert recording.header.mode == (320, 240)


def test_uneven_times_are_kept(tmp_path: Path) -> None:
    """A film whose frames last 100, 300 and 500 ms has those times, and not those of its mean rate."""
    animation = cv2.Animation()
    animation.frames = [gel(0.0, (64, 48), seed) for seed in range(5)]
    animation.durations = np.array([100, 300, 100, 500, 100])
    assert cv2.imwriteanimation(str(tmp_path / "uneven.png"), animation)
    record_video(tmp_path / "out", film_of(tmp_path / "uneven.png"), size=None, product="p", serial="s")
    times_ms = np.array(Recording.open(tmp_path / "out").times_ns()) / 1e6
    assert times_ms == pytest.approx([0, 100, 400, 500, 1000])


def test_what_a_film_shows_is_said(tmp_path: Path) -> None:
    """With a profile it is looked through at the end; a part on the gel at its start is named."""
    words = ("--profile", "cropped_lr")
    said = ran("record", tmp_path / "out", "--from-video", film(tmp_path / "a.avi"), *words)
    assert "122 frames of a.avi" in said
    assert "seen in it: 2 presses, 2 of them at rest" in said
    depths = [1.0] * 40 + [0.5] + [0.0] * 40
    pressed = written(tmp_path / "b.avi", [gel(depth, (320, 240), n) for n, depth in enumerate(depths)])
    said = ran("record", tmp_path / "pressed", "--from-video", pressed, *words)
    assert "begins with a part on the gel" in said
    assert "seen in it: 0 presses" in said


def test_a_reference_of_another_light_is_named(tmp_path: Path) -> None:
    """Pictures of presses with a free gel that was taken under another light."""
    (tmp_path / "presses").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / "presses" / f"{k}.png"), gel(1.0, (320, 240), k))
    lit = 60 * np.clip(np.linspace(-1, 1, 320), 0, 1)[None, :, None] * np.array([-0.8, 0.2, 1.0])
    other = np.clip(gel(0.0, (320, 240), 9) + lit, 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "free.png"), other)
    images = ("--from-images", tmp_path / "presses", "--reference", tmp_path / "free.png")
    said = ran("record", tmp_path / "out", *images, "--noise", "2", "--profile", "cropped_lr")
    assert "most likely of another light" in said


def test_pictures_without_a_free_gel_are_not_all_found(tmp_path: Path) -> None:
    """No press is seen where nothing is shown between them: what to give is said. An unknown profile is refused."""
    (tmp_path / "presses").mkdir()
    for k in range(3):
        cv2.imwrite(str(tmp_path / "presses" / f"{k}.png"), gel(1.0, (320, 240), k))
    images = ("--from-images", tmp_path / "presses")
    said = ran("record", tmp_path / "out", *images)
    assert "seen in it: 0 presses" in said
    assert "give its picture with --reference" in said

    refused = gelgate("record", tmp_path / "other", *images, "--profile", "cropped")
    assert "no sensor profile is named 'cropped'" in refused.sentence()
    assert not (tmp_path / "other").exists()


def test_a_black_picture_is_not_recorded(tmp_path: Path) -> None:
    """It is named, with its level."""
    cv2.imwrite(str(tmp_path / "a.png"), gel(1.0, (320, 240), 1))
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((240, 320, 3), np.uint8))
    refused = gelgate("record", tmp_path / "out", "--from-images", tmp_path).sentence()
    assert "b.png (black: its mean level is 0.0, at least 8 is expected)" in refused


def test_other_sizes_are_cut_and_scaled_only_when_asked(tmp_path: Path) -> None:
    """640x400 is not 4:3: what happens to it is said, and nothing is squashed or scaled up."""
    wide = film(tmp_path / "wide.avi", (640, 400), presses=1)
    common = ("record", tmp_path / "out", "--from-video", wide)
    for words, says in (
        (("--profile", "cropped_lr"), "640x400, profile 'cropped_lr' takes 320x240; add --resize"),
        (("--profile", "mini_lr", "--resize"), "not scaled up"),
        (("--resize",), "--resize needs --profile"),
    ):
        assert says in gelgate(*common, *words).sentence()
    said = ran(*common, "--profile", "cropped_lr", "--resize")
    assert "640x400 cut to 533x400 in the middle and scaled to 320x240" in said
    assert "seen in it: 1 press, 1 of them at rest" in said
    assert Recording.open(tmp_path / "out").header.mode == (320, 240)


def test_a_circle_stays_a_circle(tmp_path: Path) -> None:
    """The ball is as wide as it is high after a cut of the sides."""
    picture = np.zeros((480, 800, 3), np.uint8)
    cv2.circle(picture, (400, 240), 100, (255, 255, 255), -1)
    path = written(tmp_path / "ball.avi", [picture])
    record_video(tmp_path / "out", film_of(path), size=(320, 240), product="p", serial="s")
    frame = cv2.imread(str(tmp_path / "out" / "frames" / "000000.png"))
    assert frame is not None
    rows, columns = np.nonzero(frame[..., 0] > 127)
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=1)


def test_what_is_no_film_is_a_sentence(tmp_path: Path) -> None:
    """A missing file, a text, a film where a folder is expected: each names the way out."""
    with pytest.raises(DatasetError, match="there is no film at"):
        film_of(tmp_path / "absent.avi")
    text = tmp_path / "text.avi"
    text.write_text("not a film")
    with pytest.raises(DatasetError, match="no film that can be decoded"):
        film_of(text)
    path = film(tmp_path / "a.avi", presses=0)
    with pytest.raises(RecordingError, match=r"becomes one with `gelgate record FOLDER --from-video a\.avi`"):
        Recording.open(path)
    with pytest.raises(DatasetError, match="a film is read with --from-video"):
        images_in(path)


def test_cuts_are_worked_by_hand() -> None:
    """4:3 of a wide picture, of a tall one, and of one that is 4:3 already."""
    assert cut_to_aspect((640, 400), (320, 240)) == (pytest.approx((640 - 1600 / 3) / 2 / 640), 0.0)
    assert cut_to_aspect((300, 400), (320, 240)) == (0.0, pytest.approx(87.5 / 400))
    assert cut_to_aspect((640, 480), (320, 240)) == (0.0, 0.0)
    assert cut_in_words((640, 480), (320, 240)) == "640x480 scaled to 320x240"
    assert (
        cut_in_words((300, 400), (320, 240)) == "300x400 cut to 300x225 in the middle and scaled to 320x240"
    )
