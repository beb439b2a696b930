"""The gel's wear from free-gel pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.core.contact.reference import View
from edge.core.contact.wear import wear


def gel(seed: int = 0, width: int = 320) -> View:
    """A new gel: vignetted, with the noise of a mean of ten frames."""
    height = width * 3 // 4
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / width
    shade = np.exp(-(((x - 0.5) / 0.55) ** 2 + ((y - 0.375) / 0.45) ** 2))[..., None]
    colours = np.stack([150 - 80 * y, 60 + 60 * x, 60 + 90 * y], axis=-1)
    noise = np.random.default_rng(seed).normal(0, 0.7, (height, width, 3))
    return (20 + colours * shade + noise).astype(np.float32)


def scratched(view: View, start: tuple[int, int], end: tuple[int, int], depth: float = 20) -> View:
    line = np.zeros(view.shape[:2], np.float32)
    cv2.line(line, start, end, 1.0, 2, cv2.LINE_AA)
    return (view - depth * line[..., None]).astype(np.float32)


def specked(view: View, count: int) -> View:
    """Dust on a grid, 20 pixels apart."""
    marked = view.copy()
    for i in range(count):
        cv2.circle(marked, (20 + 20 * (i % 14), 20 + 20 * (i // 14)), 2, (30, 30, 30), -1)
    return marked


def test_a_gel_compared_with_itself_is_new() -> None:
    """Nothing but noise, and no mark; nor on a new gel that came with dust and a scratch."""
    assert wear(gel(), gel()).index == 0
    first, now = (specked(scratched(gel(seed), (60, 60), (140, 120)), 5) for seed in (0, 1))
    for found in (wear(gel(0), gel(1)), wear(first, now)):
        assert (found.specks, found.scratch_length) == (0, 0)
        assert found.index < 0.02


def test_a_scratch_is_measured() -> None:
    """A diagonal of 100 pixels is 100/320 of the width; two of them are twice as long."""
    one = wear(gel(), scratched(gel(1), (60, 60), (140, 120)))
    assert one.scratch_length == pytest.approx(100 / 320, abs=0.03)
    assert one.specks == 0
    two = wear(gel(), scratched(scratched(gel(1), (60, 60), (140, 120)), (180, 60), (260, 120)))
    assert two.scratch_length == pytest.approx(2 * one.scratch_length, rel=0.05)
    assert two.index > one.index


@pytest.mark.parametrize("count", [0, 1, 12, 40])
def test_specks_are_counted(count: int) -> None:
    """Each grain once, none taken for a scratch; forty are a worn gel."""
    found = wear(gel(), specked(gel(1), count))
    assert (found.specks, found.scratch_length) == (count, 0)
    assert found.index == pytest.approx(count / 40, abs=0.02)


def test_exposure_is_no_mark_and_no_shading() -> None:
    """A fifth more light changes the level, reported as such, and nothing else."""
    found = wear(gel(), (gel(1) * np.float32(1.2)).astype(np.float32))
    assert (found.specks, found.scratch_length) == (0, 0)
    assert found.level_change == pytest.approx(0.2, abs=0.01)
    assert found.shading_levels < 0.2


def test_lost_coat_is_shading() -> None:
    """A broad patch that has gone 30 levels darker shows as shading."""
    y, x = np.mgrid[0:240, 0:320].astype(np.float32)
    patch = 30 * np.exp(-(((x - 100) / 50) ** 2 + ((y - 90) / 50) ** 2))
    found = wear(gel(), (gel(1) - patch[..., None]).astype(np.float32))
    assert found.shading_levels > 1.5
    assert found.scratch_length == 0


def test_the_index_never_exceeds_one() -> None:
    """However bad: black against a new gel is worn out, and finite."""
    found = wear(gel(), np.zeros((240, 320, 3), np.float32))
    assert 0 <= found.index <= 1
    assert all(np.isfinite([found.scratch_length, found.shading_levels, found.level_change]))


def test_the_contact_view_is_enough_for_scratches() -> None:
    """At 160x120 the same scratch has the same length in picture widths."""
    half = wear(gel(0, 160), scratched(gel(1, 160), (30, 30), (70, 60)))
    assert half.scratch_length == pytest.approx(50 / 160, abs=0.05)


def test_two_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="240, 320"):
        wear(gel(), gel(0, 160))


def read(path: Path) -> View:
    bgr = cv2.imread(str(path))
    assert bgr is not None
    return np.ascontiguousarray(bgr[..., ::-1]).astype(np.float32)


def unmarked(view: View) -> View:
    """The gel as it may have been: its own picture with narrow marks filtered away."""
    levels: NDArray[np.uint8] = view.astype(np.uint8)
    return np.stack(
        [cv2.medianBlur(np.ascontiguousarray(levels[..., c]), 21) for c in range(3)], axis=-1
    ).astype(np.float32)


def test_real_gels(real_tactile: Path) -> None:
    """Two pictures of one sensor published years apart have no new mark, in either order. Against their own pictures
    without narrow marks the used gel has its scratch, 24 pixels long, and another gel its fixed fleck."""
    folders = ("joehjhuang__gs_sdk", "rpl-cmu__normalflow", "skleff1994__gs_sdk", "rpl-cmu__gelslam")
    early, late, used, dusty = (read(real_tactile / folder / "background.png") for folder in folders)
    for found in (wear(early, late), wear(late, early)):
        assert (found.specks, found.scratch_length) == (0, 0)
        assert found.index < 0.1
    assert wear(unmarked(used), used).scratch_length * 320 == pytest.approx(24, abs=4)
    fleck = wear(unmarked(dusty), dusty)
    assert (fleck.specks >= 1, fleck.scratch_length) == (True, 0)
