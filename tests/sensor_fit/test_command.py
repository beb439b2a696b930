"""`gelgate lab calibrate --simulator`, from pictures to a simulated dataset of that sensor."""

from pathlib import Path

import numpy as np
import pytest
from ball_presses import PLACES_MM, RADIUS_MM, UNSEEN, frames, renderer, write_frames
from command_line import Outcome, gelgate

from calibration.simulator.sensor_file import read_sensor


def calibrate(folder: Path, *more: object) -> Outcome:
    presses, free = folder / "presses", folder / "free.png"
    return gelgate(
        "lab", "calibrate", presses, "--no-contact", free, "--ball-radius-mm", RADIUS_MM, "-o", *more
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("balls")
    write_frames(made, [*frames(PLACES_MM[:3]), renderer().free_gel(("again",))])
    return made


def test_presses_give_a_sensor_that_is_simulated(folder: Path, tmp_path: Path) -> None:
    """The file and its picture are written, a picture without contact is named, and `simulate` reads the file."""
    file = tmp_path / "mine.toml"
    done = calibrate(folder, file, "--simulator")
    assert done.code == 0, done.err
    assert "left out: presses/04.png: no contact was found in it" in done.out
    assert "3 presses held out, 3 of them by folds" in done.out
    assert (tmp_path / "mine.png").stat().st_size > 10_000
    seen = read_sensor(file).appearance
    drawn, own = (renderer(sensor=one).free_gel().astype(np.float32) for one in (seen, UNSEEN))
    assert np.abs(drawn - own).mean() < 2
    done = gelgate(
        "lab", "simulate", "small", "-o", tmp_path / "data", "--presses", 1, "--sensor", file, "--preview"
    )
    assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("name", "words", "sentence"),
    [
        ("new.toml", (), "give --heights or --simulator"),
        ("old.toml", ("--simulator",), "or replace it with --overwrite"),
        ("a", ("--simulator",), "a sensor's file ends in .toml, found 'a'"),
        ("unit 1.toml", ("--simulator",), "up to 60 letters, digits, '-' and '_', found 'unit 1'"),
    ],
)
def test_what_cannot_be_written_is_refused(
    folder: Path, tmp_path: Path, name: str, words: tuple[str, ...], sentence: str
) -> None:
    """Without a subject, over an existing file, and under a name that a scene would not take for a file."""
    (tmp_path / "old.toml").write_text("mine")
    assert sentence in calibrate(folder, tmp_path / name, *words).sentence()
    assert (tmp_path / "old.toml").read_text() == "mine"
