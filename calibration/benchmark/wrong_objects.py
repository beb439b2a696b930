"""Presses of another object, as a gateway answers them: with and without the check of missing relief.

    python -m calibration.benchmark.wrong_objects --tactile FOLDER

A dimpled ball is learnt: real presses of a steel ball, brought to one place, with shallow dimples rendered into the
contact. The wrong objects are the ball itself, without dimples; a larger ball by the same sensor, where there is one;
and the dimpled ball with shallower dimples, with fewer ones, and smoothed. A steel ball with dimples is no golf ball,
and a smoothed picture is no object: the set shows what a gateway recognises, not how often such objects occur. The same
with simulated parts, whose features are lower or missing.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.benchmark.presses import DEVELOPMENT_DEPTH_MM, development_pictures
from calibration.benchmark.sets import SENSORS
from calibration.benchmark.touch_presses import OBJECTS, Object
from calibration.benchmark.trial import PROFILE, REGION
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.nominal_presses import named_presses
from calibration.fitting.trunks import DEFAULT_BACKBONE, open_trunk
from calibration.rendered_damage.conditions import dimmed, relit
from calibration.rendered_damage.imprint import Station
from calibration.rendered_damage.rendering import EditedPress
from calibration.simulator.field_of_view import F32, grids
from calibration.simulator.random_parts import RandomPart, Relief
from edge import registry
from edge.clock import SystemClock
from edge.core.imaging.frames import CameraFrame
from edge.core.imaging.region import Region
from edge.gateway.inspector import Inspector
from edge.model.bundle import Bundle
from edge.model.limit_facts import missing_sentence
from edge.model.scorer import Scorer

__all__ = ["Case", "answers", "case_of", "part_case", "placed", "smoothed", "with_dimples", "without_relief"]

U8 = NDArray[np.uint8]

PRESSES = 9
"""Of each wrong object."""

# A press is used where its whole contact is in the picture, and lies within this of the middle after it was moved.
_RIM_PX, _JITTER_PX = 60, 4
_TOUCHED_LEVELS = 40.0
# Dimples on a triangular lattice: distance, radius and depth in mm.
_PITCH_MM, _RADIUS_MM, _DEPTH_MM = 0.8, 0.16, 0.05
_SMOOTHED_PX = (2.0, 3.0, 6.0)
_METHODS = ("inreach", "patchcore", "subspace", "padim", "spade", "fapm")


@dataclass(frozen=True, eq=False)
class Case:
    """One learnt part. learnt, free: complete pictures. sound, wrong: what is pressed afterwards, by its name."""

    name: str
    free: U8
    learnt: Sequence[U8]
    sound: Mapping[str, Sequence[U8]]
    wrong: Mapping[str, Sequence[U8]]


def placed(rgb: U8, free: U8, rng: np.random.Generator) -> U8 | None:
    """The press's relief in the middle of the free gel, a few pixels off; None where it leaves the picture."""
    relief = rgb.astype(np.float32) - free
    levels = cv2.GaussianBlur(np.abs(relief - np.median(relief, axis=(0, 1))).sum(axis=2), (0, 0), 4)
    rows, columns = np.nonzero(levels > max(_TOUCHED_LEVELS, 0.4 * float(levels.max())))
    if not len(rows):
        return None
    y, x = float(rows.mean()), float(columns.mean())
    height, width = free.shape[:2]
    if not (_RIM_PX < x < width - _RIM_PX and _RIM_PX < y < height - _RIM_PX):
        return None
    dx, dy = rng.uniform(-_JITTER_PX, _JITTER_PX, 2)
    move = np.array([[1, 0, width / 2 + dx - x], [0, 1, height / 2 + dy - y]], np.float32)
    moved = cv2.warpAffine(relief, move, (width, height), flags=cv2.INTER_CUBIC)
    return _levels(free + moved)


def with_dimples(
    rgb: U8, free: U8, rng: np.random.Generator, depth_mm: float = _DEPTH_MM, pitch_mm: float = _PITCH_MM
) -> U8:
    """The press with dimples in the object, turned and shifted by chance. rgb, free: uint8 (h, w, 3)."""
    press = EditedPress(Station(PROFILE, Region.full(PROFILE.size), free.astype(np.float32)), rgb)
    levels = cv2.GaussianBlur(np.abs(rgb.astype(np.float32) - free).sum(axis=2), (0, 0), 2)
    touches = (levels > max(_TOUCHED_LEVELS, 0.35 * float(levels.max()))).astype(np.float32)
    dimples = _dimples(*grids(press.station.field), rng, depth_mm, pitch_mm)
    return press.with_relief(np.asarray(-cv2.GaussianBlur(touches, (0, 0), 1.5) * dimples, np.float32))


def _dimples(x: F32, y: F32, rng: np.random.Generator, depth_mm: float, pitch_mm: float) -> F32:
    """Depths in mm, float32 like x and y, mm."""
    turn, (across, down) = rng.uniform(0, 2 * np.pi), rng.uniform(0, pitch_mm, 2)
    u, v = np.cos(turn) * x + np.sin(turn) * y + across, np.cos(turn) * y - np.sin(turn) * x + down
    row = pitch_mm * np.sqrt(3)

    def away(u: F32, v: F32) -> F32:
        return np.asarray(np.hypot(u - np.round(u / pitch_mm) * pitch_mm, v - np.round(v / row) * row))

    nearest = np.minimum(away(u, v), away(u + pitch_mm / 2, v + row / 2))
    return np.asarray(depth_mm * np.exp(-0.5 * np.square(nearest / _RADIUS_MM)), np.float32)


def case_of(data: Path, chosen: Object, seed: int = 0) -> Case:
    """The case of one ball. data: the folder of real tactile frames. Errors: DatasetError."""
    presses, rng = chosen.read(data), np.random.default_rng(seed)
    free = presses.free

    def moved(pictures: Sequence[U8]) -> list[U8]:
        return [rgb for one in pictures if (rgb := placed(one, free, rng)) is not None]

    def dimpled(pictures: Sequence[U8], **changes: float) -> list[U8]:
        return [with_dimples(rgb, free, rng, **changes) for rgb in pictures]

    learnt, held, larger = (
        moved(list(pictures)) for pictures in (presses.learnt.values(), presses.held.values(), presses.others)
    )
    sound = dimpled(held)
    wrong = {
        "the ball without dimples": held,
        "dimples half as deep": dimpled(held, depth_mm=_DEPTH_MM / 2),
        "dimples twice as far apart": dimpled(held, pitch_mm=2 * _PITCH_MM),
        **_smoother(sound, free),
        "a larger ball": larger,
    }
    conditions = {"sound": sound, **_conditions(sound, rng)}
    shown = {name: list(pictures)[:PRESSES] for name, pictures in wrong.items() if len(pictures)}
    return Case(chosen.name, free, dimpled(learnt), conditions, shown)


def part_case(number: int) -> Case:
    """The case of one random part: without its features, with lower ones, smoothed, and pressed less deeply."""
    pictures, rng = development_pictures(number), np.random.default_rng(number)
    sound, free = pictures.sound[:PRESSES], pictures.free

    def pressed(depth: float = 1.0, height: float = 1.0) -> list[U8]:
        depth_mm = depth * DEVELOPMENT_DEPTH_MM
        return development_pictures(number, None, lambda part: _lower(part, height), depth_mm).sound[:PRESSES]

    conditions = {
        "sound": pictures.sound,
        **_conditions(sound, rng),
        "pressed 0.85 as deep": pressed(0.85),
        "pressed 0.7 as deep": pressed(0.7),
    }
    wrong = {
        "without its features": pressed(height=0.0),
        "features a third as high": pressed(height=1 / 3),
        **_smoother(sound, free),
    }
    return Case(f"simulated part {number}", free, pictures.learnt, conditions, wrong)


def _lower(part: RandomPart, height: float) -> RandomPart:
    """The part with features of this share of their height."""

    def lowered(feature: Relief) -> Relief:
        return lambda x, y: np.asarray(np.float32(height) * feature(x, y), np.float32)

    return replace(part, features=tuple(lowered(feature) for feature in part.features))


def _conditions(sound: Sequence[U8], rng: np.random.Generator) -> dict[str, list[U8]]:
    return {
        "other light": [relit(rgb, rng) for rgb in sound],
        "exposure 0.8": [dimmed(rgb, 0.8) for rgb in sound],
        "exposure 1.2": [dimmed(rgb, 1.2) for rgb in sound],
    }


def _smoother(sound: Sequence[U8], free: U8) -> dict[str, list[U8]]:
    return {
        f"smoothed by {px / PROFILE.pixels_per_mm:.2f} mm": [smoothed(rgb, free, px) for rgb in sound]
        for px in _SMOOTHED_PX
    }


def smoothed(rgb: U8, free: U8, sigma_px: float) -> U8:
    """The press with its relief blurred, as a smoother object shows."""
    relief = cv2.GaussianBlur(rgb.astype(np.float32) - free, (0, 0), sigma_px)
    return _levels(free + relief)


def _levels(found: NDArray[np.floating]) -> U8:
    return np.asarray(np.clip(np.rint(found), 0, 255), np.uint8)


def without_relief(bundle: Bundle) -> Bundle:
    """The bundle without the check of missing relief: its map is multiplied by nothing."""
    if "relief_unit" not in bundle.bank:
        return bundle
    return replace(bundle, bank={**bundle.bank, "relief_unit": np.zeros((1, 1), np.float32)})


def answers(bundle: Bundle, free: U8, pictures: Sequence[U8]) -> list[str]:
    """What the gateway says of each press: `pass`, `fail`, `unsure`, or the reason of a rejection."""
    inspector = Inspector(Scorer(bundle, 1), SystemClock())
    named = {f"{k}": rgb for k, rgb in enumerate(pictures)}
    touches = named_presses(named, bundle.profile, bundle.region, no_contact=[free]).touches
    found = []
    for number, (rgb, touch) in enumerate(zip(pictures, touches, strict=True)):
        png = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1].tobytes()
        seen = inspector.inspect(CameraFrame(png, 0, number, is_on_demand=True), touch)
        rejection = None if seen.verdict is None else seen.verdict.rejection
        found.append(seen.word if rejection is None else rejection.reason.value)
    return found


def _bundle(case: Case, method: str, backbone: str) -> Bundle:
    detector = registry.detector(method)
    trunk = open_trunk(backbone, detector.taps(detector.parameters("corrected")))
    learnt = {f"{k}": rgb for k, rgb in enumerate(case.learnt)}
    nominal = named_presses(learnt, PROFILE, REGION, no_contact=[case.free])
    config = FitConfig(case.name, "middle", PROFILE, REGION, detector, trunk, threads=1)
    return fit_files(nominal, config, created="").bundle()


def _table(case: Case, method: str, backbone: str, say: Callable[[str], None]) -> None:
    both = _bundle(case, method, backbone)
    say(
        f"\n{case.name}, {method}, {len(case.learnt)} presses learnt: {missing_sentence(both.manifest.facts)}\n"
    )
    say("| pressed | presses | pass without | pass with | answers with |\n|---|---|---|---|---|")
    for name, pictures in {**case.sound, **case.wrong}.items():
        before, after = (answers(bundle, case.free, pictures) for bundle in (without_relief(both), both))
        words = ", ".join(f"{count} {word}" for word, count in sorted(Counter(after).items()))
        passed = f"{before.count('pass')} | {after.count('pass')}"
        say(f"| {name} | {len(pictures)} | {passed} | {words} |")


def main() -> None:
    """The tables of every ball of the development set and of random parts, in Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tactile", type=Path, help="folder of real tactile frames; without it simulated parts alone"
    )
    parser.add_argument("--parts", type=int, default=4, help="how many simulated parts")
    parser.add_argument("--method", nargs="+", default=_METHODS, help="methods that learn the part")
    parser.add_argument("--backbone", default=DEFAULT_BACKBONE)
    chosen = parser.parse_args()
    for make in _cases(chosen.tactile, chosen.parts):
        case = make()
        for method in chosen.method:
            _table(case, method, chosen.backbone, partial(print, flush=True))


def _cases(data: Path | None, parts: int) -> Iterator[Callable[[], Case]]:
    if data is not None:
        for found in OBJECTS:
            is_ball = found.name.startswith("ball") and not found.is_registered
            if found.sensor in SENSORS["real-touch"] and is_ball:
                yield partial(case_of, data, found)
    for number in range(parts):
        yield partial(part_case, number)


if __name__ == "__main__":
    main()
