"""`gelgate lab evaluate-new-gel`: what a bundle loses on a new gel, and what each way to keep it brings back.

The presses are of one part on two gels.

The lamps and the camera stay, so a gel is a variation of the sensor's appearance: its tint, the strength of its coat
and its stiffness. Its grain, dust and scratches are its own and come from the renderer's `gel_id`. Banks are compared
as they are fitted, with one limit for all places.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.rows import write_json
from calibration.experiments.harness.study import require_known
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, score_held_out
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.tap_reader import TapReader
from calibration.fitting.trunks import open_trunk
from calibration.folders import require_folder
from calibration.metrics import aupro, auroc
from calibration.progress import progress
from calibration.simulator.defects import DEFECTS
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR
from calibration.simulator.gel_variation import another_gel
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S, place_damage
from calibration.simulator.pose import HeightField
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import MASK_DEPTH_MM, Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance
from calibration.simulator.streams import Streams
from edge import registry
from edge.core.detector import Bank, Features, Nominal
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

__all__ = [
    "AGAIN",
    "BEFORE",
    "METHODS",
    "WAYS",
    "Row",
    "another_unit",
    "evaluate_new_gel",
    "measure_part",
    "table",
]

U8 = NDArray[np.uint8]

METHODS: Final = ("padim", "fapm", "spade", "inreach", "patchcore")
# Seeds of parts, gels and presses; development and judgement share none.
SEEDS = {"development": 51_000, "judgement": 53_000}
ALPHA: Final = 0.05
PROFILE: Final = profile("cropped_lr")
REGION: Final = Region.centre(PROFILE.size)

# The strongest answer of one unit in terms of another's, on public frames.
_UNIT_RESPONSE: Final = 1.7

# As the random parts of the backbones' trials.
_DEPTH_MM: Final = 0.4
_FREE_FRAMES: Final = 6
_NOMINAL: Final = 24
# What a change of the gel may cost at most.
_FEW: Final = 8
_TESTED: Final = 20
# Presses that each gel has had, in all its pictures: wear is not what is measured.
_AGE: Final = 20
# The lamps are warm.
_POWERED_S: Final = 3600.0

BEFORE, AGAIN = "old gel", "pressed again"
WAYS: Final[Mapping[str, str]] = {
    BEFORE: "bank and limit of the old gel, on the old gel",
    AGAIN: "as many presses on the new gel, bank and limit from them",
    "as it is": "bank and limit of the old gel",
    "limit": "bank of the old gel, limit from the scores of 8 presses: what `gelgate bundle carry` does",
    "8 alone": "bank and limit from 8 presses on the new gel",
}
"""Every way with what it takes."""

Row = Mapping[str, Any]
"""One way on one part: part, method, way, aupro up to 1 %, auroc, false_alarms and detected, shares at the limit.

On the old gel no damage was pressed, and all but false_alarms are None."""


def another_unit(name: str) -> SensorAppearance:
    """Give the hard limit: a unit with other lamps and the strongest other response that was seen."""
    unit = SENSORS[name]
    return replace(unit, slope_response=unit.slope_response * _UNIT_RESPONSE)


class _GelPresses:
    """One part on one gel."""

    def __init__(
        self, shape: HeightField, number: int, seed: int, sensor: SensorAppearance, gel: str
    ) -> None:
        self.shape, self.streams = shape, Streams(seed)
        # Odd and even parts alternate between a hand and a fixture, as those of the backbones' trials.
        jitter = PARTS["PZ3" if number % 2 else "PZ5"].jitter
        self.renderer = Renderer(LR, DEFAULT_EFFECTS, sensor, jitter, self.streams, gel, f"session of {gel}")

    def nominal(self, pieces: range) -> NominalPresses:
        """Make one press of each sound piece, and the free gel before them."""
        free = [
            self.renderer.free_gel(("free", k), _AGE, Exposure(k, _POWERED_S)) for k in range(_FREE_FRAMES)
        ]
        pictures = {f"s{piece:05d}_p0": self.press(piece) for piece in pieces}
        return gather_presses(pictures, PROFILE, REGION, no_contact=free)

    def press(self, piece: int) -> U8:
        """Press a sound piece: a picture (240, 320, 3)."""
        whole, exposure = self._piece(piece)
        return self.renderer.press(whole, _DEPTH_MM, (piece,), presses=_AGE, exposure=exposure)

    def press_damaged(self, piece: int, kind: str, severity: float) -> tuple[U8, NDArray[np.bool_]]:
        """Press a damaged piece: a picture, and where damage shows, bool (240, 320)."""
        whole, exposure = self._piece(piece)
        rng = self.streams("defect", piece)
        defect = place_damage(self.shape, kind, severity, _DEPTH_MM, MASK_DEPTH_MM, rng)
        return self.renderer.damage(whole, defect, _DEPTH_MM, (piece,), presses=_AGE, exposure=exposure)

    def _piece(self, piece: int) -> tuple[HeightField, Exposure]:
        whole = specimen(self.shape, self.streams("specimen", piece))
        return whole, Exposure(0, _POWERED_S + piece * PRESS_CYCLE_S)

    def make_scored(self, number: int) -> tuple[U8, NDArray[np.bool_]]:
        """Regions of sound and damaged pieces in turn, uint8 (n, h, w, 3), and their masks, bool (n, h, w)."""
        kinds, rng = tuple(DEFECTS), self.streams("severities", number)
        frames, masks = [], []
        for k in range(_TESTED):
            damaged, mask = self.press_damaged(4000 + k, kinds[k % len(kinds)], float(rng.uniform(0.3, 1.0)))
            frames += [self.press(3000 + k), damaged]
            masks += [np.zeros_like(mask), mask]
        return np.stack([REGION.crop(f) for f in frames]), np.stack([REGION.crop(m) for m in masks])


def measure_part(
    seed: int, number: int, methods: Sequence[str] = METHODS, *, is_other_unit: bool = False
) -> Iterator[Row]:
    """Measure every method and way on the random part of this number.

    is_other_unit: the hard limit, another unit instead of another gel.
    """
    rng = np.random.default_rng([seed, number])
    shape = random_part(np.random.default_rng([seed, number, 1]))
    before = another_gel(SENSORS["unit_a" if is_other_unit else "unit_b"], rng)
    after = another_unit("unit_b") if is_other_unit else another_gel(SENSORS["unit_b"], rng)
    with reproducible_opencv():
        old_gel = _GelPresses(shape, number, seed, before, f"old {number}")
        new_gel = _GelPresses(shape, number, seed, after, f"new {number}")
        again = new_gel.nominal(range(1000, 1000 + _NOMINAL))
        old = old_gel.nominal(range(_NOMINAL))
        sound = np.stack([REGION.crop(old_gel.press(2000 + k)) for k in range(_TESTED)])
        frames, masks = new_gel.make_scored(number)
    few = again.first(_FEW)
    detectors = {method: registry.detector(method) for method in methods}
    taps = sorted({tap for one in detectors.values() for tap in one.taps(one.parameters())})
    trunk, frame = open_trunk("tactile_resnet18", taps).graph, (REGION.height, REGION.width)
    reader = TapReader(trunk, taps, frame, PROFILE.pixels_per_mm)
    nominals = [reader.nominal(one) for one in (old, again, few)]
    features = [reader.take(one) for one in (sound, few.frames, frames)]
    for method, detector in detectors.items():
        for way, row in _compare(reader.learner(detector), nominals, features, masks):
            yield {"part": f"part {number}", "method": method, "way": way, **row}


def _compare(
    learner: Learner, nominals: Sequence[Nominal], features: Sequence[Features], masks: NDArray[np.bool_]
) -> Iterator[tuple[str, Row]]:
    """Measure every way. nominals: old, again, few. features: sound on the old gel; few and scored on the new gel."""
    (old, at_old), (again, at_again), (alone, at_alone) = (_learn(learner, one) for one in nominals)
    sound, few, scored = features
    before = learner.score(old, sound, range(_TESTED)).scores
    false_alarms = float((before > at_old).mean())
    yield BEFORE, {"aupro": None, "auroc": None, "false_alarms": false_alarms, "detected": None}
    carried = conformal_threshold(learner.score(old, few, range(_FEW)).scores, ALPHA).value
    by_old, by_alone, by_again = (learner.score(b, scored, range(len(masks))) for b in (old, alone, again))
    is_damaged = np.asarray(masks.any(axis=(1, 2)), np.bool_)
    for way, found, limit in (
        ("as it is", by_old, at_old),
        ("limit", by_old, carried),
        ("8 alone", by_alone, at_alone),
        (AGAIN, by_again, at_again),
    ):
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


def table(rows: Sequence[Row]) -> str:
    """Write Markdown: a section for each method, a row for each way, means over parts."""
    parts = len({row["part"] for row in rows})
    text = [f"{parts} parts, each on two gels; means over parts, and the most that one part loses.\n"]
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        losses = f"lost to `{AGAIN}`", "most lost"
        head = [method, "AU-PRO up to 1 %", *losses, "image AUROC", "false alarms", "detected"]
        lines = [_line([row for row in own if row["way"] == way], own) for way in WAYS]
        text.append(markdown_table(head, [line for line in lines if line]))
    return "\n".join([*text, *(f"- `{way}`: {what}." for way, what in WAYS.items())])


def _line(of_way: Sequence[Row], own: Sequence[Row]) -> list[str]:
    """Write the means of one way; nothing where it has no rows. own: all rows of the method."""
    if not of_way:
        return []
    way = of_way[0]["way"]
    again = {row["part"]: row["aupro"] for row in own if row["way"] == AGAIN}
    lost = [
        again[row["part"]] - row["aupro"]
        for row in of_way
        if row["aupro"] is not None and row["part"] in again
    ]
    is_compared = lost and way != AGAIN
    means = [
        f"{np.mean(values):.3f}"
        if (values := [row[name] for row in of_way if row[name] is not None])
        else "-"
        for name in ("aupro", "auroc", "false_alarms", "detected")
    ]
    losses = [f"{np.mean(lost):+.3f}", f"{max(lost):+.3f}"] if is_compared else ["-", "-"]
    return [way, means[0], *losses, *means[1:]]


def evaluate_new_gel(
    which: Annotated[
        str, typer.Option("--set", help="development, or judgement: parts and gels apart.")
    ] = "development",
    parts: Annotated[int, typer.Option(help="Parts, each on two gels.", min=1, max=1000)] = 4,
    method: Annotated[list[str] | None, typer.Option(help="These detectors only.")] = None,
    other_unit: Annotated[
        bool, typer.Option("--other-unit", help="Another unit instead of another gel: the hard limit.")
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write every figure to this JSON file.")] = None,
) -> None:
    """What a bundle loses on a new gel, and how to keep it.

    On simulated parts, each pressed on two gels of one sensor. Prints for each detector and each way to keep a bundle
    AU-PRO, image AUROC, and false alarms and detection at the limit."""
    require_known("set", [which], SEEDS)
    require_known("detector of this study", method or (), METHODS)
    require_folder(json)
    rows: list[Row] = []
    with progress("parts", parts) as advance:
        for number in range(parts):
            rows += measure_part(SEEDS[which], number, method or METHODS, is_other_unit=other_unit)
            advance(number + 1)
            write_json(json, rows)
    typer.echo(table(rows))
