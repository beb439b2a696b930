"""Marker dots at fit and at the gateway: when they are looked for, and that both fill the same."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import tiny
from command_line import gelgate, refuse_by_example
from marker_gel import dotted, lattice, light, spread
from station import gel
from tiny_fit import config as tiny_config

from calibration.fitting.carry import CarryConfig, carry_bundle
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.presses.preparation import prepare_presses, take_out_dots
from edge.clock import SystemClock
from edge.core.arrays import U8
from edge.core.errors import BundleCorrupt, BundleMismatch
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.marker_dots import find_marker_dots
from edge.core.imaging.region import Region
from edge.model.bundle import parse_manifest
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from export.merge import merged_graph

SENSOR = profile("cropped_lr")
REGION = Region.centre(SENSOR.size)
PLACES = lattice(SENSOR.size[::-1])
CONFIG = tiny_config(profile=SENSOR, region=REGION, threads=1, limit="plain")


def picture(number: int, *, has_dots: bool = True, is_dented: bool = False, shift_px: float = 0.0) -> U8:
    """A press of the station's part; 0 is the free gel. The dots move from press to press. shift_px: of another gel."""
    rng = np.random.default_rng(number)
    rgb = gel(rng, 1.0 if number else 0.0, is_dented)[..., ::-1].copy()
    moved = spread(PLACES, (160, 120), rng.uniform(1, 9)) if number else PLACES
    return dotted(rgb, moved + shift_px) if has_dots else rgb


@cache
def pressed(first: int = 1, *, has_dots: bool = True) -> NominalPresses:
    names = {f"s{k:03d}_p0": picture(k, has_dots=has_dots) for k in range(first, first + 8)}
    return gather_presses(names, SENSOR, REGION, no_contact=[picture(0, has_dots=has_dots)])


@cache
def fitted(*, has_dots: bool = True) -> Fitted:
    return fit_files(pressed(has_dots=has_dots), CONFIG, created="2026-01-01")


def test_a_bundle_carried_to_another_marker_gel_has_the_dots_of_that_gel() -> None:
    """Its dots lie two pixels further. New presses on it pass, and damaged ones fail."""
    names = {f"s{k:03d}_p0": picture(k, shift_px=2.0) for k in range(30, 38)}
    presses = gather_presses(names, SENSOR, REGION, no_contact=[picture(0, shift_px=2.0)])
    old = fitted().bundle()
    anywhere = replace(old, manifest=old.manifest.model_copy(update={"contact": None}))
    carried = carry_bundle(anywhere, presses, CarryConfig("2026-02-01", threads=1))
    scorer, limit = Scorer(carried.bundle(), 1), carried.manifest.threshold.value

    def score(number: int, is_dented: bool) -> float:
        rgb = picture(number, shift_px=2.0, is_dented=is_dented)
        return scorer.score(REGION.crop(rgb).copy()).anomaly_score

    assert max(score(k, False) for k in range(40, 44)) <= limit
    assert min(score(k, True) for k in range(40, 44)) > limit
    assert old.manifest.dots is not None
    assert carried.manifest.dots is not None
    shift = np.array(carried.manifest.dots.places)[0] - np.array(old.manifest.dots.places)[0]
    assert shift.tolist() == pytest.approx([2, 2], abs=0.3)


def shows(presses: NominalPresses) -> bool:
    return take_out_dots(presses, SENSOR.pixels_per_mm).dots is not None


def without_free_gel(frames: list[U8]) -> NominalPresses:
    return NominalPresses(np.stack(frames), tuple(f"{k}" for k in range(len(frames))))


def test_dots_of_the_free_gel_are_filled_in_presses_and_free_gel() -> None:
    presses, plain = take_out_dots(pressed(), SENSOR.pixels_per_mm), pressed(has_dots=False)
    assert presses.no_contact is not None
    assert plain.no_contact is not None
    assert np.abs(presses.no_contact.astype(int) - plain.no_contact).max() <= 20
    assert all(find_marker_dots(rgb, SENSOR.pixels_per_mm) is None for rgb in presses.frames)
    assert "nothing is judged under them, 2" in presses.facts["dots"]


def test_without_dots_nothing_changes() -> None:
    presses = pressed(has_dots=False)
    assert take_out_dots(presses, SENSOR.pixels_per_mm) is presses


def test_the_published_methods_learn_dots_as_they_are() -> None:
    assert prepare_presses(pressed(), SENSOR.pixels_per_mm, "paper") is pressed()


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ([dotted(light(), spread(PLACES, px=k)) for k in range(5)], True),
        ([dotted(light(), PLACES) for _ in range(3)], False),
        ([*(dotted(light(), PLACES) for _ in range(4)), light()], False),
        ([np.repeat(dotted(light(), PLACES)[..., :1], 3, axis=2) for _ in range(5)], False),
        ([dotted(light(), PLACES[:: 1 + k % 2], 8 + 4 * (k % 2)) for k in range(5)], False),
    ],
    ids=["all presses", "too few", "not all", "grey light", "unlike ones"],
)
def test_without_a_free_gel_all_presses_must_show_them(frames: list[U8], expected: bool) -> None:
    """In grey light a part with a regular texture looks the same."""
    assert shows(without_free_gel(frames)) == expected


def test_a_free_gel_without_dots_has_none_whatever_presses_show() -> None:
    """Then it is the part that has regular dark spots."""
    presses = without_free_gel([dotted(light(), PLACES) for _ in range(5)])
    plain = NominalPresses(presses.frames, presses.names, no_contact=light()[None])
    assert not shows(plain)


def test_the_gateway_fills_what_the_fit_filled() -> None:
    """A nominal press scores at the gateway as the bank has it, and the press keeps the camera's picture."""
    scorer, press = Scorer(fitted().bundle(), 1), picture(3)
    learnt = prepare_presses(pressed(), SENSOR.pixels_per_mm).frames[2]
    png = cv2.imencode(".png", np.ascontiguousarray(press[..., ::-1]))[1].tobytes()
    frame = CameraFrame(png, 0, 0, is_on_demand=True)
    found = Inspector(scorer, SystemClock()).inspect(frame, pressed().touches[2])
    assert found.score == scorer.score_in_pose(learnt).anomaly_score
    assert found.rgb is not None
    assert (found.rgb == REGION.crop(press)).all()
    assert "dots" in found.latency_ms


def test_dots_at_other_places_are_no_damage() -> None:
    """Of new presses of the part no more fail than eight nominal ones promise, 1 in 9; each damaged one fails, and
    scores higher than every sound one."""
    scorer, limit = Scorer(fitted().bundle(), 1), fitted().manifest.threshold.value
    scores = [
        [
            scorer.score(REGION.crop(picture(k, is_dented=is_dented)).copy()).anomaly_score
            for k in range(20, 28)
        ]
        for is_dented in (False, True)
    ]
    assert sum(score > limit for score in scores[0]) <= 2
    assert min(scores[1]) > max(limit, *scores[0])


def test_a_bundle_without_dots_says_nothing_of_them() -> None:
    """Older programs read it: its bytes are those of before."""
    files = fitted(has_dots=False).files
    assert "dots" not in json.loads(files["manifest.json"])
    assert "is_smoothed" not in json.loads(tiny.tiny_files()[1]["manifest.json"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"apart_px": 5.0}, "narrower than they lie apart"),
        ({"places": []}, "places"),
        ({"darker": 1.5}, "darker"),
        ({"width_px": 1e6}, "width_px"),
        ({"colour": "black"}, "colour"),
    ],
)
def test_dots_that_make_no_sense_are_refused_by_name(change: dict[str, object], said: str) -> None:
    manifest = json.loads(fitted().files["manifest.json"])
    manifest["dots"] |= change
    with pytest.raises(BundleCorrupt) as error:
        parse_manifest(json.dumps(manifest).encode(), "here")
    assert said in str(error.value)


def test_a_graph_alone_does_not_replace_such_a_bundle() -> None:
    with pytest.raises(BundleMismatch, match="dots of a marker gel"):
        merged_graph(fitted().bundle())


def test_a_bundle_says_what_is_not_judged(tmp_path: Path) -> None:
    """`gelgate bundle inspect` has the sentence of the fit."""
    for has_dots in (True, False):
        bundle = fitted(has_dots=has_dots).write(tmp_path / f"bolt-{has_dots}")
        assert ("nothing is judged under them" in gelgate("bundle", "inspect", bundle).out) == has_dots


def test_the_example_refuses_such_a_bundle(tmp_path: Path) -> None:
    """It would score dots."""
    bundle = fitted().write(tmp_path / "bolt")
    assert "the dots of a marker gel are filled before the graphs" in refuse_by_example(bundle)
