"""The colours of nominal presses: how they are measured, stored and compared with presses of the same unit."""

import dataclasses
import json

import numpy as np
import pytest
import tiny
from tiny_fit import config

from calibration.experiments.backbones.sets import Sizes, part_trial
from calibration.fitting.fit import fit_files
from calibration.fitting.presses.colours import LEAST_LIMIT, LIMIT_FACTOR, colour_warnings, nominal_colours
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.errors import BundleCorrupt
from edge.core.imaging.sensor_check import check_sensor
from edge.model.bundle import parse_manifest


def flat(*colours: tuple[int, int, int]) -> np.ndarray:
    """One frame of each colour, uint8 (n, 32, 32, 3)."""
    return np.stack([np.tile(np.array(colour, np.uint8), (32, 32, 1)) for colour in colours])


def fitted(frames: np.ndarray) -> dict[str, bytes]:
    return fit_files(NominalPresses(frames, ("",) * len(frames)), config(), created="").files


def test_like_presses_have_the_least_limit() -> None:
    """Worked by hand: the mean colour, no spread, 14 %; one press is enough."""
    for frames in (flat((150, 100, 50)), flat(*[(150, 100, 50)] * 3)):
        colours = nominal_colours(frames)
        assert colours is not None
        assert colours.cells == (((150.0, 100.0, 50.0),) * 8,) * 8
        assert (colours.spread, colours.limit) == (0.0, LEAST_LIMIT)


def test_each_press_is_held_against_the_others() -> None:
    """Worked by hand: of two presses with red at 110 and 90, one is 20 levels from the other after equal light."""
    colours = nominal_colours(flat((110, 100, 90), (90, 100, 110)))
    assert colours is not None
    assert colours.cells[0][0] == (100.0, 100.0, 100.0)
    assert colours.spread == pytest.approx(0.2)
    assert colours.limit == pytest.approx(LIMIT_FACTOR * 0.2)


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (flat(*[(150, 100, 50)] * 3), None),
        (flat((120, 100, 80), (100, 100, 100)), "differ by 20.0%"),
        (flat((90, 90, 90), (110, 110, 110), (100, 100, 100)), "no colour"),
    ],
)
def test_doubtful_colours_are_said(frames: np.ndarray, said: str | None) -> None:
    """Presses of two sensors under one bundle, and grey pictures, which suit no camera: the lamps are coloured."""
    found = colour_warnings(nominal_colours(frames))
    assert len(found) == bool(said)
    assert said is None or said in found[0]


def test_black_presses_have_no_colours() -> None:
    """No limit, because it would refuse everything else, or nothing."""
    assert nominal_colours(flat((3, 2, 1), (3, 2, 1))) is None
    assert colour_warnings(None) == []


def test_the_manifest_carries_them() -> None:
    """Written by a fit, they accept the presses they come from; older bundles have none."""
    frames = tiny.presses(6)
    text = fitted(frames)["manifest.json"]
    colours = parse_manifest(text, "x").colours
    assert colours is not None
    assert all(check_sensor(frame, colours.nominal()) is None for frame in frames)
    swapped = np.ascontiguousarray(flat((200, 100, 20)))
    assert check_sensor(swapped[0], colours.nominal()) is not None
    older = {key: value for key, value in json.loads(text).items() if key != "colours"}
    assert parse_manifest(json.dumps(older).encode(), "x").colours is None


@pytest.mark.parametrize(
    "cells", [[], [[]], [[[1, 2, 3]], []], [[[1, 2]]], [[[1, 2, 256]]], [[[0, 0, 0]]]], ids=str
)
def test_broken_colours_are_a_sentence(cells: list) -> None:
    """A manifest edited by hand is refused by the field's name."""
    content = json.loads(fitted(tiny.presses(4))["manifest.json"])
    content["colours"]["cells"] = cells
    with pytest.raises(BundleCorrupt, match="colours"):
        parse_manifest(json.dumps(content).encode(), "x")


@pytest.mark.parametrize(("part", "condition"), [("PZ3", "unseen sensor"), ("PZ1", "worn gel")])
def test_simulated_presses_of_one_unit_are_accepted(part: str, condition: str) -> None:
    """Drifting lamps, tilted presses that touch in part, a gel that wears, sound and damaged pieces: all are scored."""
    trial = part_trial(part, condition, Sizes(pieces=3, held_out=1, presses=2, damaged=3, free_gels=1))
    colours = nominal_colours(trial.nominal.frames)
    assert colours is not None
    assert len(trial.frames) >= 5
    nominal = dataclasses.replace(colours.nominal(), limit=LEAST_LIMIT)
    assert [check_sensor(np.ascontiguousarray(rgb), nominal) for rgb in trial.frames] == [None] * len(
        trial.frames
    )
