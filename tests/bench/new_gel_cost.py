"""What a bundle loses on a new gel of its sensor, and what each way to keep it brings back.

`python tests/bench/new_gel_cost.py [PARTS] [--other-unit]` prints the table of docs/gel.md: random parts on which
nothing was chosen, each pressed on two gels. The lamps and the camera stay, so a gel is a variation of the sensor's
appearance; its grain, dust and scratches are its own. Banks are compared as they are fitted, with one limit for all
places. Two minutes of one core a part.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from calibration.experiments.harness.markdown import markdown_table
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, TapReader, score_held_out
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.metrics.pixel import aupro
from calibration.metrics.summary import auroc
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S, place_damage
from calibration.simulator.pose import HeightField
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import MASK_DEPTH_MM, Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance, another_gel
from calibration.simulator.streams import Streams
from edge import registry
from edge.core.arrays import U8, Mask
from edge.core.detector import Bank, Features, Nominal
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

METHODS: Final = ("padim", "fapm", "spade", "inreach", "patchcore")
SEED: Final = 53_000
"""Of parts, gels and presses; development had 51,000."""
ALPHA: Final = 0.05
PROFILE: Final = profile("cropped_lr")
REGION: Final = Region.centre(PROFILE.size)

UNIT_RESPONSE: Final = 1.7
"""The strongest answer of one unit in terms of another's, on public frames."""

DEPTH_MM: Final = 0.4
NOMINAL, FEW, TESTED, FREE_FRAMES = 24, 8, 20, 6
"""FEW: what a change of the gel may cost at most."""
AGE, POWERED_S = 20, 3600.0
"""Presses that each gel has had, in all its pictures, for wear is not what is measured; the lamps are warm."""

AGAIN: Final = "pressed again"
WAYS: Final = ("old gel", AGAIN, "as it is", "limit", "8 alone")
"""The old bundle on the old gel; bank and limit of the new gel; of the old gel; the old bank with a limit from 8
presses, as `gelgate bundle carry`; bank and limit from 8 presses."""

Row = Mapping[str, Any]
"""One way on one part: part, method, way, aupro up to 1 %, auroc, false_alarms and detected, shares at the limit. On
the old gel no damage was pressed, and all but false_alarms are None."""


class GelPresses:
    """One part on one gel."""

    def __init__(self, shape: HeightField, number: int, sensor: SensorAppearance, gel: str) -> None:
        self.shape, self.streams = shape, Streams(SEED)
        # Odd and even parts alternate between a hand and a fixture.
        jitter = PARTS["PZ3" if number % 2 else "PZ5"].jitter
        self.renderer = Renderer(LR, DEFAULT_EFFECTS, sensor, jitter, self.streams, gel, f"session of {gel}")

    def nominal(self, pieces: range) -> NominalPresses:
        """Make one press of each sound piece, and the free gel before them."""
        free = [self.renderer.free_gel(("free", k), AGE, Exposure(k, POWERED_S)) for k in range(FREE_FRAMES)]
        pictures = {f"s{piece:05d}_p0": self.press(piece) for piece in pieces}
        return gather_presses(pictures, PROFILE, REGION, no_contact=free)

    def press(self, piece: int) -> U8:
        """Press a sound piece: a picture (240, 320, 3)."""
        whole, exposure = self._piece(piece)
        return self.renderer.press(whole, DEPTH_MM, (piece,), presses=AGE, exposure=exposure)

    def scored(self, number: int) -> tuple[U8, Mask]:
        """Regions of sound and damaged pieces in turn, uint8 (n, h, w, 3), and their masks, bool (n, h, w)."""
        kinds, rng = tuple(DEFECTS), self.streams("severities", number)
        frames, masks = [], []
        for k in range(TESTED):
            whole, exposure = self._piece(4000 + k)
            severity, at = float(rng.uniform(0.3, 1.0)), self.streams("defect", 4000 + k)
            defect = place_damage(self.shape, kinds[k % len(kinds)], severity, DEPTH_MM, MASK_DEPTH_MM, at)
            damaged, mask = self.renderer.damage(
                whole, defect, DEPTH_MM, (4000 + k,), presses=AGE, exposure=exposure
            )
            frames += [self.press(3000 + k), damaged]
            masks += [np.zeros_like(mask), mask]
        return np.stack([REGION.crop(f) for f in frames]), np.stack([REGION.crop(m) for m in masks])

    def _piece(self, piece: int) -> tuple[HeightField, Exposure]:
        whole = specimen(self.shape, self.streams("specimen", piece))
        return whole, Exposure(0, POWERED_S + piece * PRESS_CYCLE_S)


def measure_part(number: int, is_other_unit: bool) -> Iterator[Row]:
    """Measure every method and way on the random part of this number. is_other_unit: the hard limit, a unit with other
    lamps and the strongest other response that was seen."""
    rng = np.random.default_rng([SEED, number])
    shape = random_part(np.random.default_rng([SEED, number, 1]))
    before = another_gel(SENSORS["unit_a" if is_other_unit else "unit_b"], rng)
    unit = SENSORS["unit_b"]
    other = replace(unit, slope_response=unit.slope_response * UNIT_RESPONSE)
    after = other if is_other_unit else another_gel(unit, rng)
    with reproducible_opencv():
        old_gel = GelPresses(shape, number, before, f"old {number}")
        new_gel = GelPresses(shape, number, after, f"new {number}")
        again = new_gel.nominal(range(1000, 1000 + NOMINAL))
        old = old_gel.nominal(range(NOMINAL))
        sound = np.stack([REGION.crop(old_gel.press(2000 + k)) for k in range(TESTED)])
        frames, masks = new_gel.scored(number)
    few = again.first(FEW)
    detectors = {method: registry.detector(method) for method in METHODS}
    taps = sorted({tap for one in detectors.values() for tap in one.taps(one.parameters())})
    trunk, frame = open_trunk("tactile_resnet18", taps).graph, (REGION.height, REGION.width)
    reader = TapReader(trunk, taps, frame, PROFILE.pixels_per_mm)
    nominals = [reader.nominal(one) for one in (old, again, few)]
    features = [reader.take(one) for one in (sound, few.frames, frames)]
    for method, detector in detectors.items():
        for way, row in _compare(reader.learner(detector), nominals, features, masks):
            yield {"part": number, "method": method, "way": way, **row}


def _compare(
    learner: Learner, nominals: Sequence[Nominal], features: Sequence[Features], masks: Mask
) -> Iterator[tuple[str, Row]]:
    """Measure every way. nominals: old, again, few. features: sound on the old gel; few and scored on the new gel."""
    (old, at_old), (again, at_again), (alone, at_alone) = (_learn(learner, one) for one in nominals)
    sound, few, scored = features
    before = learner.score(old, sound, range(TESTED)).scores
    none = dict.fromkeys(("aupro", "auroc", "detected"))
    yield "old gel", {**none, "false_alarms": float((before > at_old).mean())}
    carried = conformal_threshold(learner.score(old, few, range(FEW)).scores, ALPHA).value
    by_old, by_alone, by_again = (learner.score(b, scored, range(len(masks))) for b in (old, alone, again))
    is_damaged = np.asarray(masks.any(axis=(1, 2)), np.bool_)
    ways = ((by_again, at_again), (by_old, at_old), (by_old, carried), (by_alone, at_alone))
    for way, (found, limit) in zip(WAYS[1:], ways, strict=True):
        fails = found.scores > limit
        yield (
            way,
            {
                "aupro": aupro(found.maps, masks),
                "auroc": auroc(found.scores, is_damaged),
                "false_alarms": float(fails[~is_damaged].mean()),
                "detected": float(fails[is_damaged].mean()),
            },
        )


def _learn(learner: Learner, nominal: Nominal) -> tuple[Bank, float]:
    """Learn a bank and its limit, from the scores of held-out presses."""
    bank = learner.bank(nominal)
    folds, _ = divide_presses((None,) * nominal.presses, 5, np.random.default_rng(0))
    own = learner.score(bank, nominal.features, range(nominal.presses)).scores
    scores = np.maximum(score_held_out(learner, nominal, folds).sound.scores, own)
    return bank, conformal_threshold(scores, ALPHA).value


def write_means(rows: Sequence[Row]) -> str:
    """Write a row for each method and way, means over parts."""
    lines = []
    for method in METHODS:
        at = {way: [row for row in rows if (row["method"], row["way"]) == (method, way)] for way in WAYS}
        for way, own in at.items():
            measures = [[row[name] for row in own] for name in ("aupro", "auroc", "false_alarms", "detected")]
            means = ["-" if None in values else f"{np.mean(values):.3f}" for values in measures]
            lost = [
                again["aupro"] - row["aupro"]
                for again, row in zip(at[AGAIN], own, strict=True)
                if row["aupro"] is not None
            ]
            lines.append([method, way, *means, f"{max(lost):+.3f}" if lost else "-"])
    heading = ["method", "way", "AU-PRO", "image AUROC", "false alarms", "detected", "most AU-PRO lost"]
    return markdown_table(heading, lines)


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("parts", nargs="?", type=int, default=4)
    words.add_argument("--other-unit", action="store_true", help="another unit instead of another gel")
    given = words.parse_args()
    print(write_means([row for k in range(given.parts) for row in measure_part(k, given.other_unit)]))
