"""Camera bytes to pictures and views."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edge.core.errors import ConfigError, FrameCorrupt
from edge.core.imaging.decode import VIEW_SIZE, decode, decode_view
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import MINI_CONTROLS, PROFILES, profile
from edge.core.imaging.sensor_profile import SensorProfile

SMALL = SensorProfile("small", (656, 496), (1 / 7, 1 / 7), (80, 60), 4, 4.0)


def encoded(rgb: NDArray[np.uint8], extension: str = ".jpg", sequence: int = 7) -> CameraFrame:
    parameters = [cv2.IMWRITE_JPEG_QUALITY, 95] if extension == ".jpg" else []
    done, payload = cv2.imencode(extension, np.ascontiguousarray(rgb[..., ::-1]), parameters)
    assert done
    return CameraFrame(payload.tobytes(), timestamp_ns=123, sequence=sequence)


def gradient(width: int, height: int) -> NDArray[np.uint8]:
    """Red rises to the right, green downwards, blue is 40: every pixel encodes its place."""
    x = np.broadcast_to(np.linspace(20, 220, width), (height, width))
    y = np.broadcast_to(np.linspace(20, 220, height)[:, None], (height, width))
    return np.stack([x, y, np.full((height, width), 40.0)], axis=-1).astype(np.uint8)


def test_colour_order_is_rgb_once() -> None:
    """A red frame gives a red picture, a blue one a blue picture."""
    for channel in range(3):
        rgb = np.full((240, 320, 3), 30, np.uint8)
        rgb[..., channel] = 200
        picture = decode(encoded(rgb), PROFILES["cropped_lr"])
        assert int(np.argmax(picture.mean(axis=(0, 1)))) == channel
        assert int(np.argmax(decode_view(encoded(rgb), PROFILES["cropped_lr"]).mean(axis=(0, 1)))) == channel


def test_a_png_without_crop_comes_back_bit_by_bit() -> None:
    """Scale 1, no border, same size: nothing is resampled."""
    rgb = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    picture = decode(encoded(rgb, ".png"), PROFILES["cropped_lr"])
    assert np.array_equal(picture, rgb)


@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_the_border_is_cut_in_camera_pixels(extension: str) -> None:
    """One seventh of each side is cut: the corner pixels show the gradient at 1/7 and 6/7 of the frame."""
    picture = decode(encoded(gradient(656, 496), extension), SMALL)
    assert picture.shape == (60, 80, 3)
    low, high = 20 + 200 / 7, 20 + 200 * 6 / 7
    half_pixel = 200 * (5 / 7) / 80 / 2
    assert picture[30, 0, 0] == pytest.approx(low + half_pixel, abs=2)
    assert picture[30, -1, 0] == pytest.approx(high - half_pixel, abs=2)
    assert picture[0, 40, 1] == pytest.approx(low + half_pixel * 80 / 60, abs=2)
    assert picture[-1, 40, 1] == pytest.approx(high - half_pixel * 80 / 60, abs=2)


@pytest.mark.parametrize(
    "form",
    [(cv2.IMWRITE_JPEG_RST_INTERVAL, 8), (cv2.IMWRITE_JPEG_PROGRESSIVE, 1), (cv2.IMWRITE_JPEG_OPTIMIZE, 1)],
)
def test_every_form_of_jpeg_gives_the_same_picture(form: tuple[int, int]) -> None:
    """With restart markers, progressive, or with code tables of its own: frames are decoded whole, bit for bit."""
    bgr = np.ascontiguousarray(gradient(656, 496)[..., ::-1])
    plain, other = (
        CameraFrame(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 90, *more])[1].tobytes(), 123, 7)
        for more in ((), form)
    )
    assert other.payload != plain.payload
    assert np.array_equal(decode(other, SMALL), decode(plain, SMALL))
    assert np.array_equal(decode_view(other, SMALL), decode_view(plain, SMALL))


@pytest.mark.parametrize("scale", [1, 2, 4, 8])
def test_decode_scales_agree_on_geometry(scale: int) -> None:
    """Every decode scale, JPEG or PNG, puts the gradient where the full decode puts it, within a level or two."""
    at_scale = SensorProfile("small", (656, 496), (1 / 7, 1 / 7), (40, 30), scale, 2.0)
    full = SensorProfile("small", (656, 496), (1 / 7, 1 / 7), (40, 30), 1, 2.0)
    frame = gradient(656, 496)
    expected = decode(encoded(frame, ".png"), full).astype(np.float32)
    for extension in (".jpg", ".png"):
        found = decode(encoded(frame, extension), at_scale).astype(np.float32)
        assert np.abs(found - expected).max() <= 3


@pytest.mark.parametrize("name", ["mini_lr", "mini_hr", "mini_hr43"])
def test_native_frames_give_the_size_of_their_profile(name: str) -> None:
    """A 3280x2464 JPEG becomes the profile's size, and a 160x120 float view from the same crop."""
    frame = encoded(gradient(3280, 2464))
    picture = decode(frame, PROFILES[name])
    assert picture.shape == (PROFILES[name].size[1], PROFILES[name].size[0], 3)
    view = decode_view(frame, PROFILES[name])
    assert view.dtype == np.float32
    assert view.shape == (120, 160, 3)  # of the pictures of free gels that stations keep
    small = cv2.resize(picture, VIEW_SIZE, interpolation=cv2.INTER_AREA).astype(np.float32)
    assert np.abs(view - small).max() <= 3


def test_black_and_white_survive() -> None:
    """0 and 255 arrive as 0 and 255: flat frames are pictures, judged by quality, not broken bytes."""
    for value in (0, 255):
        frame = encoded(np.full((240, 320, 3), value, np.uint8))
        assert (decode(frame, PROFILES["cropped_lr"]) == value).all()
        assert (decode_view(frame, PROFILES["cropped_lr"]) == value).all()


NOISE = encoded(np.random.default_rng(1).integers(0, 256, (496, 656, 3), dtype=np.uint8)).payload
JPEG, PNG = (encoded(gradient(656, 496), extension).payload for extension in (".jpg", ".png"))
DAMAGED = [
    *((payload, "") for payload in (b"", b"\xff\xd8", b"\xff\xd8\xff\xd9", b"hello" * 100, PNG[:8])),
    *((whole[: int(len(whole) * share)], "") for whole in (JPEG, PNG) for share in (0.1, 0.5, 0.999)),
    (JPEG[:-2], "lost USB packets"),
    (PNG[:-2], "lost USB packets"),
    (
        NOISE[: len(NOISE) // 2] + b"\xff\xd9",
        "last rows",
    ),  # the last rows are flat, although the first are not
    (NOISE[: len(NOISE) // 4] + NOISE[len(NOISE) * 3 // 10 :], "last rows"),  # a gap: both ends are there
    (PNG[:40] + bytes(len(PNG) - 80) + PNG[-40:], ""),
    (encoded(gradient(640, 480)).payload, r"640x480.*656x496.*none that ships"),
    (encoded(gradient(320, 240)).payload, r"320x240.*656x496.*--profile: cropped_lr"),
]


@pytest.mark.parametrize(("payload", "words"), DAMAGED)
def test_a_damaged_frame_is_refused(payload: bytes, words: str) -> None:
    """No picture at all, cut at any place even if every row decodes, damaged within, or of another sensor."""
    with pytest.raises(FrameCorrupt, match=f"frame 3.*{words}"):
        decode(CameraFrame(payload, 0, 3), SMALL)
    with pytest.raises(FrameCorrupt):
        decode_view(CameraFrame(payload, 0, 3), SMALL)


def test_zero_padding_behind_the_end_marker_is_accepted() -> None:
    """Zeros after the end marker are accepted: some cameras fill their buffer with them."""
    frame = encoded(gradient(656, 496))
    padded = CameraFrame(frame.payload + b"\0" * 500, 0, 0)
    assert np.array_equal(decode(padded, SMALL), decode(frame, SMALL))


def test_profiles_know_their_scale_and_names() -> None:
    """15.77 px/mm at 320 columns, four times that at 1280; an unknown name gets the nearest one as a suggestion."""
    assert profile("mini_lr").pixels_per_mm == pytest.approx(15.77, abs=0.01)
    assert profile("mini_hr").pixels_per_mm == pytest.approx(63.09, abs=0.01)
    assert profile("mini_lr").controls == MINI_CONTROLS
    assert all(name == entry.name for name, entry in PROFILES.items())
    with pytest.raises(ConfigError, match="did you mean 'mini_hr43'"):
        profile("mini_hr34")
