"""Bad input of pictures: each has a sentence that names the picture and says what to do."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_gel import dotted, lattice
from numpy.typing import NDArray

from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.presses.preparation import take_out_dots
from calibration.fitting.presses.strangers import find_misexposed, find_pieces, find_repeated, small_view
from edge.core.arrays import F64, U8
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile

SIZE = 320, 240
PROFILE = SensorProfile("test", SIZE, (0.0, 0.0), SIZE, 1, 15.77)
ROWS, COLUMNS = np.mgrid[:240, :320]
X, Y = COLUMNS / 160 - 1, ROWS / 120 - 1
DOTS = lattice((240, 320))


@cache
def noise_of(number: int) -> F64:
    return np.random.default_rng(number).normal(0, 1, (240, 320, 3))


def gel(number: int, added: float | F64 = 0.0, tilt: float = 0.0) -> U8:
    """The gel under a light that falls off to the sides, and what a part adds."""
    light = np.stack(
        [130 - 30 * X**2 + 20 * Y, 120 + 25 * X - 10 * X * Y, 110 - 20 * Y**2 + tilt * X], axis=-1
    )
    return np.clip(np.rint(light + added + noise_of(number)), 0, 255).astype(np.uint8)


@cache
def press(number: int) -> U8:
    """A ball in a fixture, one side brighter, the other darker."""
    x, y, radius = np.random.default_rng([1, number]).uniform((155, 115, 58), (165, 125, 64))
    inside = (COLUMNS - x) ** 2 + (ROWS - y) ** 2 < radius**2
    return gel(number, np.where(inside, 60 * np.sign(COLUMNS - x + 1e-9), 0)[..., None])


def curved(number: int) -> U8:
    """A lying cylinder, pressed less and more."""
    return gel(number, (25 + 3 * number) * (Y - Y**3)[..., None])


def same(number: int) -> U8:
    return np.clip(np.rint(press(1) + noise_of(number)), 0, 255).astype(np.uint8)


def bright(number: int) -> U8:
    return np.clip(press(number).astype(int) * 2, 0, 255).astype(np.uint8)


def blurred(number: int) -> U8:
    return np.asarray(cv2.GaussianBlur(press(number), (0, 0), 2), np.uint8)


def unfocused(number: int) -> U8:
    """A lens blurs the part, and the camera's grain stays."""
    noise = noise_of(number)
    sharp = press(number) - noise
    return np.clip(np.rint(cv2.GaussianBlur(sharp, (0, 0), 4) + noise), 0, 255).astype(np.uint8)


@cache
def marked(number: int) -> U8:
    return dotted(press(number), DOTS)


Presses = Callable[[int], U8]
TWO = "2 of 8 presses ('good/a.png', 'good/b.png')"
BAD: dict[str, tuple[Presses, Presses, U8 | None, str]] = {
    "turned": (press, lambda k: press(k)[::-1, ::-1], gel(99), f"between the parts {TWO}"),
    "mirrored": (press, lambda k: press(k)[:, ::-1], None, "turned or mirrored"),
    "another light": (press, lambda k: gel(k, tilt=60), None, "--leave-out 'good/a.png'"),
    "free gel": (press, gel, gel(99), f"no contact is seen in {TWO}"),
    "one press again": (press, same, None, f"{TWO} are the same as another"),
    "too bright": (press, bright, None, f"too bright a light in {TWO}"),
    "another exposure": (
        press,
        lambda k: (0.6 * press(k)).astype(np.uint8),
        None,
        f"another exposure in {TWO}",
    ),
    "blurred": (press, blurred, None, f"another sharpness in {TWO}: the grain of 'good/a.png' is 0.2"),
    "markers": (press, marked, gel(99), f"the dots of a marker gel in {TWO}"),
    "no markers": (marked, press, dotted(gel(99), DOTS), f"no dots of a marker gel in {TWO}"),
    "no markers, gel not known": (
        marked,
        press,
        None,
        f"no dots of a marker gel in {TWO}, unlike the others",
    ),
    "markers on all": (marked, marked, gel(99), "of another gel"),
    "picture of a press": (press, press, press(50), "('free/free.png') show the part, and are left out"),
    "picture of another light": (press, press, gel(99, tilt=60), "('free/free.png') differs by"),
    "curved part": (curved, lambda k: curved(k - 20), None, "it may hold the part"),
}


def save(path: Path, rgb: U8) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 0])
    return path


def read(folder: Path, good: Presses, other: Presses, free: U8 | None, count: int = 6) -> tuple[str, ...]:
    """Read so many presses and two others as `gelgate fit` does; what it says."""
    for k in range(count):
        save(folder / "good" / f"{k}.png", good(k))
    for k, name in ((20, "a"), (21, "b")):
        save(folder / "good" / f"{name}.png", other(k))
    files = [] if free is None else [save(folder / "free" / "free.png", free)]
    presses = read_presses([folder / "good"], PROFILE, Region.full(SIZE), no_contact=files)
    return take_out_dots(presses, PROFILE.pixels_per_mm).faults


@pytest.mark.parametrize(("good", "other", "free", "said"), BAD.values(), ids=BAD)
def test_bad_input_is_named(
    tmp_path: Path, good: Presses, other: Presses, free: U8 | None, said: str
) -> None:
    faults = read(tmp_path, good, other, free)
    assert any(said in fault for fault in faults), faults


def test_presses_of_another_gel_are_said_to_have_its_dots_first_and_not_to_be_blurred(tmp_path: Path) -> None:
    """They are of another unit too, whose picture is less noisy: their sharpness is no news."""
    faults = read(tmp_path, press, lambda k: dotted(blurred(k)[::-1, ::-1], DOTS), gel(99))
    assert [fault.partition(TWO)[0] for fault in faults] == [
        "the dots of a marker gel in ",
        "between the parts ",
    ]


def test_presses_out_of_focus_are_named_beside_eight_sharp_ones(tmp_path: Path) -> None:
    (said,) = read(tmp_path, press, unfocused, gel(99), count=8)
    assert "2 of 10 presses ('good/a.png', 'good/b.png') are less sharp than the others" in said


@pytest.mark.parametrize(
    ("good", "free"), [(press, None), (press, gel(99)), (marked, None), (marked, dotted(gel(99), DOTS))]
)
def test_of_good_input_nothing_is_said(tmp_path: Path, good: Presses, free: U8 | None) -> None:
    assert read(tmp_path, good, good, free) == ()


def test_the_same_press_again_counts_as_the_same_piece(tmp_path: Path) -> None:
    """Learnt with a copy, a press is no new one; but of other pieces, if named so, only copies are not believed."""
    for k in range(12):
        rgb = press(k % 4)
        noise = np.random.default_rng(k).integers(0, 2, rgb.shape, np.uint8) * (k > 7)
        save(tmp_path / "good" / f"{k:02d}.png", rgb ^ noise)
        save(tmp_path / "named" / f"bolt_crest_s{k:03d}_p00.png", rgb ^ noise)
    save(tmp_path / "good" / "other.png", press(12))
    good, named = (
        read_presses([tmp_path / name], PROFILE, Region.full(SIZE)).specimens for name in ("good", "named")
    )
    assert good == (*[f"good/{k:02d}.png" for k in range(4)] * 3, None)
    assert named == (*["000", "001", "002", "003"] * 2, "008", "009", "010", "011")


@pytest.mark.parametrize(
    "again", [lambda k: small_view(press(1)), lambda k: small_view(same(k))], ids=["copy", "same"]
)
def test_a_press_without_a_name_is_of_the_piece_that_it_is_the_same_as(again: Presses) -> None:
    """Whichever comes first: a named piece keeps all of its presses."""
    pieces = [None, None, "1", "1"]
    _, found = find_repeated(list("abcd"), [again(1), again(2), again(3), small_view(press(2))], pieces)
    assert found == ["1"] * 4


@pytest.mark.parametrize("light", [0.97, 1.03, 1.1])
def test_the_same_press_under_more_or_less_light_is_of_the_same_piece(light: float) -> None:
    """A lamp warms up between two pictures of one press; learnt by the one, a bank knows the other."""
    views = [small_view(press(1)), small_view(press(2)), small_view((same(2) * light).astype(np.uint8))]
    (said,), found = find_repeated(list("abc"), views, [None] * 3)
    assert said.startswith("1 of 3 presses ('c') are the same as another, but for noise or light: ")
    assert found == ["a", None, "a"]


def test_of_many_presses_those_that_differ_at_one_place_are_told_apart() -> None:
    """Most are told apart by a few places; these two only by all."""
    rng = np.random.default_rng(3)
    views = list(rng.integers(90, 150, (250, 120, 160, 3), np.uint8))
    views[40] = views[200] ^ 1
    views[41] = views[200].copy()
    views[41][51:57, 61:67] += 30
    (said,), found = find_repeated([f"{k}.png" for k in range(250)], views, [None] * 250)
    assert said.startswith("1 of 250 presses ('200.png') are the same as another")
    assert {k for k, piece in enumerate(found) if piece} == {40, 200}


def test_of_presses_that_are_darker_and_brighter_no_false_level_is_said() -> None:
    """The level is that of the one that is named with it."""
    views = [np.full((120, 160, 3), level, np.uint8) for level in (99, 99, 59, 99, 179, 99)]
    (said,) = find_misexposed(list("abcdef"), views)
    assert said.startswith(
        "another exposure in 2 of 6 presses ('c', 'e'): the level of 'c' is 0.60 times that of the others; "
    )


def test_frames_of_one_film_are_one_piece_and_are_held_out_in_stretches(tmp_path: Path) -> None:
    """A ball that rolls back and forth, its frames numbered without zeros; one that is left out changes nothing."""
    for k in range(20):
        x, y = (COLUMNS - 160 - 100 * np.sin(k / 5)) / 40, (ROWS - 120) / 40
        save(tmp_path / "film" / f"{k}.png", gel(k, (80 * x * np.exp(-(x**2) - y**2))[..., None]))
    film, less = (
        read_presses([tmp_path / "film"], PROFILE, Region.full(SIZE), leave_out=names)
        for names in ([], ["film/3.png"])
    )
    assert any("frames of one film: from 'film/0.png' on" in fault for fault in film.faults)
    assert set(film.specimens) == {"film/0.png"}
    assert [film.names[k] for k in film.film] == [f"film/{k}.png" for k in range(20)]
    assert [less.names[k] for k in less.film] == [f"film/{k}.png" for k in range(20) if k != 3]
    folds, said = divide_presses(film.specimens, 5, np.random.default_rng(0), film=film.film)
    assert [len(held) for held in folds] == [7, 7, 6]
    assert {film.names[k] for k in folds[0]} == {f"film/{k}.png" for k in range(7)}
    assert "are of 1 piece" in said[0]


def rolled(number: int, x: float, y: float) -> U8:
    """A view of a ball at this place."""
    right, down = (COLUMNS - x) / 40, (ROWS - y) / 40
    return small_view(gel(number, (80 * right * np.exp(-(right**2) - down**2))[..., None]))


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_a_film_is_known_where_only_every_second_to_fourth_frame_is_there(step: int) -> None:
    """The ball goes 40 pixels from frame to frame at most, a quarter of its way; one that is set down anywhere is no
    film."""
    names = [f"{k}.png" for k in range(20)]
    ways = [(160 + 100 * np.sin(k * step / 8), 120 + 60 * np.sin(k * step / 13)) for k in range(20)]
    anywhere = np.random.default_rng(step).uniform((60, 60), (260, 180), (20, 2)).tolist()
    film, presses = ([rolled(k, *way) for k, way in enumerate(places)] for places in (ways, anywhere))
    assert find_pieces(names, film, [None] * 20)[1] == ["0.png"] * 20
    assert find_pieces(names, presses, [None] * 20)[1] == [None] * 20


@pytest.mark.parametrize(
    "drift", [lambda rgb, k: rgb + k, lambda rgb, k: rgb * (1 + k / 100)], ids=["offset", "gain"]
)
def test_drifting_light_is_no_film(drift: Callable[[NDArray[np.int64], int], F64]) -> None:
    """Each is nearer to the next one in its level alone: the part is held well, and only its depth differs."""
    depths = np.random.default_rng(0).uniform(25, 29, 20)
    views = [
        small_view(
            np.clip(drift(gel(k, depth * (Y - Y**3)[..., None]).astype(int), k), 0, 255).astype(np.uint8)
        )
        for k, depth in enumerate(depths)
    ]
    names = [f"{k}.png" for k in range(20)]
    assert find_pieces(names, views, [None] * 20)[2] == ()


def test_of_three_presses_the_one_that_does_not_belong_is_named(tmp_path: Path) -> None:
    """Two agree. With a free gel also one that shows it, and whether that is the right one is not known; of two that
    differ none is named as the stranger."""
    for name, other in (("turned", press(2)[::-1, ::-1]), ("free", gel(2))):
        for number in (0, 1):
            save(tmp_path / name / f"{number}.png", press(number))
        save(tmp_path / name / "other.png", other)
    free = [save(tmp_path / "gel.png", gel(99))]
    whole = Region.full(SIZE)
    (turned,) = read_presses([tmp_path / "turned"], PROFILE, whole).faults
    empty, unchecked = read_presses([tmp_path / "free"], PROFILE, whole, no_contact=free).faults
    assert "1 of 3 presses ('turned/other.png') differ from the others" in turned
    assert "no contact is seen in 1 of 3 presses ('free/other.png')" in empty
    assert "of the light of the presses cannot be checked with 3 presses: look at it, or" in unchecked
    (tmp_path / "turned" / "0.png").unlink()
    assert read_presses([tmp_path / "turned"], PROFILE, whole).faults == ()
