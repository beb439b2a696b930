"""Simulated frames compared with real ones, where those are available."""

from pathlib import Path

import numpy as np

from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.realism import ball_figures, histogram_overlap, levels, read_rgb, spectrum
from calibration.simulator.renderer import Renderer
from calibration.simulator.sensor_appearance import SENSORS


def test_the_free_gel_has_the_real_histograms(real_tactile: Path) -> None:
    """Mean, spread and percentiles of each channel within 3 levels of the real unit."""
    real = levels(read_rgb(real_tactile / "skleff1994__gs_sdk" / "background.png"))
    made = levels(Renderer(LR, DEFAULT_EFFECTS, SENSORS["unit_b"]).free_gel().astype(np.float32))
    assert np.abs(real - made).max() < 3


def test_a_balls_press_is_the_real_one(real_tactile: Path) -> None:
    """Profile across the contact's edge within 5 levels, histograms with an overlap of 80 %, spectra within half."""
    figures = ball_figures(real_tactile / "skleff1994__gs_sdk")
    assert figures.presses > 20
    assert np.abs(figures.edge[0] - figures.edge[1]).max() < 5
    assert figures.overlap.min() > 0.8
    assert figures.error < 0.4 * figures.signal
    assert (np.abs(np.log2(figures.spectrum[0] / figures.spectrum[1])) < 0.6).all()


def test_figures_of_equal_pictures_are_equal() -> None:
    """A picture's histogram overlaps completely with itself."""
    picture = np.random.default_rng(0).normal(100, 20, (240, 320, 3)).astype(np.float32)
    assert np.allclose(histogram_overlap(picture, picture), 1)


def test_the_spectrum_finds_a_wave_in_its_band() -> None:
    """A wave of 1.5 cycles per mm and 10 levels has a gradient of 20 pi * 1.5 / sqrt(2) = 67 levels per mm there."""
    x = (np.arange(320) * 0.0634)[None, :, None]
    wave = np.broadcast_to(100 + 10 * np.sin(2 * np.pi * 1.5 * x), (240, 320, 3)).astype(np.float32)
    bands = spectrum(wave)
    assert abs(bands[2] - 66.6) < 2
    assert bands[[0, 1, 3, 4]].max() < 5
