"""How far simulated frames are from real ones, in figures: `python -m calibration.simulator.realism FOLDER`.

FOLDER holds public frames of real sensors and is not part of the product; docs/simulator.md has the figures. Three
comparisons: the free gel, 51 presses of one ball simulated at the same places, and threads.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import F32, LR
from calibration.simulator.parts import PARTS
from calibration.simulator.pose import Pose
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS
from calibration.simulator.shapes import f32
from calibration.simulator.streams import named_streams
from edge.core.imaging.known_profiles import MINI_LR_MM_PER_PX

__all__ = ["BANDS", "BallFigures", "ball_figures", "histogram_overlap", "levels", "read_rgb", "spectrum"]

BANDS = ((0.25, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 7.5))
"""Bands of the gradient spectrum in cycles per mm; 7.9 is the finest that 320x240 can show."""

# Distance to the labelled circle in mm at which the signal is compared, negative inside.
EDGE_MM = np.arange(-1.2, 2.4, 0.3)

_BALL_MM = 9.47
# A pressed gel lifts around the ball, so the ball went deeper than the labelled circle's cap by about this factor.
_DEEPER = 1.2


def read_rgb(path: Path) -> F32:
    """A picture as float32 (240, 320, 3) RGB. Errors: ValueError when it cannot be read."""
    picture = cv2.imread(str(path))
    if picture is None:
        raise ValueError(f"{path} is no picture")
    return f32(cv2.resize(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), LR.size, interpolation=cv2.INTER_AREA))


def levels(rgb: F32) -> NDArray[np.float64]:
    """Per channel: mean, sd, percentiles 1, 50 and 99; float64 (3, 5)."""
    flat = rgb.reshape(-1, 3).astype(np.float64)
    return np.column_stack([flat.mean(0), flat.std(0), *np.percentile(flat, (1, 50, 99), axis=0)])


def histogram_overlap(one: F32, other: F32) -> NDArray[np.float64]:
    """Per channel: the overlap of two histograms, bins of 4 levels from -256 to 256; float64 (3,)."""
    edges = np.arange(-256, 257, 4)
    shares = []
    for c in range(3):
        p, q = (np.histogram(values[..., c], edges)[0] / values[..., c].size for values in (one, other))
        shares.append(float(np.minimum(p, q).sum()))
    return np.array(shares)


def spectrum(rgb: F32, window: tuple[slice, slice] = (slice(None), slice(None))) -> NDArray[np.float64]:
    """Rms of the grey picture's gradient in each of BANDS, grey levels per mm, float64 (len(BANDS),).

    window: the part of the picture that is used; it is tapered at its sides.
    """
    grey = rgb.mean(axis=2)[window].astype(np.float64)
    taper = np.hanning(grey.shape[0])[:, None] * np.hanning(grey.shape[1])[None]
    power = np.abs(np.fft.fft2((grey - grey.mean()) * taper)) ** 2 / grey.size / (taper**2).sum()
    fy, fx = (np.fft.fftfreq(n, MINI_LR_MM_PER_PX) for n in grey.shape)
    frequency = np.hypot(fy[:, None], fx[None])
    gradient = power * (2 * np.pi * frequency) ** 2
    return np.array([np.sqrt(gradient[(frequency >= low) & (frequency < high)].sum()) for low, high in BANDS])


@dataclass(frozen=True)
class BallFigures:
    """Real against simulated presses of one ball at the same places.

    edge: signal by distance to the contact's edge, grey levels, float64 (2, len(EDGE_MM)): real, simulated.
    overlap: of the colour changes inside contact, per channel. error, signal: rms over the contact, grey levels.
    spectrum: rms gradient by band inside contact, (2, bands). presses: how many.
    """

    edge: NDArray[np.float64]
    overlap: NDArray[np.float64]
    error: float
    signal: float
    spectrum: NDArray[np.float64]
    presses: int


def _presses(folder: Path) -> Iterator[tuple[F32, tuple[float, float], float]]:
    """(frame, circle centre in px, radius in px) of every press that is well inside the view."""
    for press in sorted((folder / "9.470mm").iterdir()):
        with np.load(press / "label.npz") as label:
            centre, radius = label["center"], float(label["radius"])
        if 60 < centre[0] < 260 and 60 < centre[1] < 180:
            yield read_rgb(press / "gelsight.png"), (float(centre[0]), float(centre[1])), radius


def ball_figures(folder: Path) -> BallFigures:
    """Compare the labelled ball presses of `skleff1994__gs_sdk` with presses simulated at the same places."""
    background = read_rgb(folder / "background.png")
    renderer = Renderer(
        LR, tuple(name for name in DEFAULT_EFFECTS if name not in ("pose_jitter", "wear", "dust"))
    )
    free = f32(renderer.free_gel())
    rows, columns = np.mgrid[0:240, 0:320]
    edges, pairs, bands = [], [], []
    for number, (frame, (cx, cy), radius) in enumerate(_presses(folder)):
        real = frame - background
        simulated = _ball(renderer, cx, cy, radius, number) - free
        distance = (np.hypot(columns - cx, rows - cy) - radius) * MINI_LR_MM_PER_PX
        edges.append([_signal_by_distance(change, distance) for change in (real, simulated)])
        inside = distance < 0
        pairs.append((real[inside], simulated[inside]))
        box = (slice(int(cy - radius), int(cy + radius)), slice(int(cx - radius), int(cx + radius)))
        bands.append([spectrum(picture, box) for picture in (frame, simulated + background)])
    real, simulated = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    return BallFigures(
        np.nanmean(np.array(edges), axis=0),
        histogram_overlap(real, simulated),
        float(np.sqrt(((real - simulated) ** 2).mean())),
        float(np.sqrt((real**2).mean())),
        np.mean(np.array(bands), axis=0),
        len(edges),
    )


def _ball(renderer: Renderer, cx: float, cy: float, radius_px: float, number: int) -> F32:
    big, at = _BALL_MM / 2, ((cx + 0.5 - 160) * MINI_LR_MM_PER_PX, (cy + 0.5 - 120) * MINI_LR_MM_PER_PX)
    cap = big - np.sqrt(big**2 - (radius_px * MINI_LR_MM_PER_PX) ** 2)

    def height(x: F32, y: F32) -> F32:
        return f32(np.sqrt(np.maximum(big**2 - x * x - y * y, 0)) - big)

    return f32(renderer.press(height, float(cap) * _DEEPER, ("ball", number), Pose(at)))


def _signal_by_distance(change: F32, distance: NDArray[np.float64]) -> NDArray[np.float64]:
    strength = np.linalg.norm(cv2.GaussianBlur(change, (0, 0), 1.0), axis=2)
    step = EDGE_MM[1] - EDGE_MM[0]
    rings = [(distance >= low) & (distance < low + step) for low in EDGE_MM]
    return np.array([strength[ring].mean() if ring.sum() > 30 else np.nan for ring in rings])


def _text(values: NDArray[np.float64], digits: int = 0) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def main(folder: Path) -> None:
    """Print the comparison."""
    units = {
        "unit_a": folder / "rpl-cmu__gelslam" / "background.png",
        "unit_b": folder / "skleff1994__gs_sdk" / "background.png",
        "unit_c": folder / "joehjhuang__gs_sdk" / "background.png",
    }
    print("free gel: mean, sd, 1 %, 50 %, 99 % of red | green | blue; noise is on")
    for name, path in units.items():
        simulated = f32(Renderer(LR, DEFAULT_EFFECTS, SENSORS[name]).free_gel())
        for what, rgb in (("real", read_rgb(path)), ("simulated", simulated)):
            print(f"  {name} {what:<10}" + " | ".join(_text(row) for row in levels(rgb)))
    ball = ball_figures(folder / "skleff1994__gs_sdk")
    print(f"ball 9.47 mm, {ball.presses} presses at the same places")
    print(f"  mm from the edge    {_text(EDGE_MM + 0.15, 2)}")
    for what, row in zip(("real", "simulated"), ball.edge, strict=True):
        print(f"  signal, {what:<12}{_text(row)}")
    print(f"  histograms of the change in common: {_text(ball.overlap, 2)} (R G B)")
    print(f"  rms error {ball.error:.1f} of a signal of {ball.signal:.1f} grey levels")
    print(f"gradient spectrum, grey levels per mm, bands {BANDS} cycles per mm")
    for what, row in zip(("real ball", "simulated ball"), ball.spectrum, strict=True):
        print(f"  {what:<24}{_text(row, 1)}")
    for what, rgb, window in _threads(folder):
        print(f"  {what:<24}{_text(spectrum(rgb, window), 1)}   99 %: {_text(levels(rgb[window])[:, 4])}")


def _threads(folder: Path) -> Iterator[tuple[str, F32, tuple[slice, slice]]]:
    """Real threads and a simulated one, each with a window of 80 pixels about its middle."""
    real = folder / "RavenLiang1005__UniCal" / "GelSight"
    for name, row, column in (("0000", 150, 195), ("0001", 120, 195), ("0002", 115, 170)):
        yield f"real thread {name}", read_rgb(real / f"{name}.png"), _window(row, column)
    renderer = Renderer(LR, DEFAULT_EFFECTS, streams=named_streams(0))
    thread = PARTS["PZ1"].positions["pos1"]
    yield "simulated PZ1", f32(renderer.press(thread, 0.55, ("thread",))), _window(120, 160)


def _window(row: int, column: int) -> tuple[slice, slice]:
    return slice(row - 40, row + 40), slice(column - 40, column + 40)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
