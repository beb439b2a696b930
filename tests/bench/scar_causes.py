"""How well scars of the gel and damage of the part are told apart, on simulated worn gels.

`python tests/bench/scar_causes.py [GELS] [--brief]` prints the table of docs/gel.md: the cause that each alarm was
given, by what raised it, with exact binomial limits. Every press is judged as a station judges it; what raises an alarm
is known by making the press again, without the scars or without the damage. Gels with scratches, dents, hairs and worn
coat; six ways to place parts, with a bundle each. A gel of each placing takes two minutes of one core.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np

from calibration.experiments.harness.markdown import markdown_table
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.simulator.defects import DEFECTS, Damaged, Defect
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR, grids
from calibration.simulator.parts import PARTS, specimen
from calibration.simulator.plan import PRESS_CYCLE_S, place_damage
from calibration.simulator.pose import HeightField, Jitter, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import MASK_DEPTH_MM, Exposure, Renderer
from calibration.simulator.scars import SCARS, Scar, mark_gel, random_scar
from calibration.simulator.streams import Streams
from edge import registry
from edge.core.arrays import F32, U8, Mask
from edge.core.binomial import rate_limits
from edge.core.contact.mask import touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.errors import PoseNotFound
from edge.core.gel_scars.gel_scars import GelScars, Judged
from edge.core.gel_scars.press import ScoredPress, measure_moves, without_marks
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.core.verdict import Cause
from edge.model.scorer import Scored, Scorer

Shares = tuple[tuple[Scar, float], ...]
"""Scars, each with the share of its full strength."""

SEED: Final = 6_000_000
"""Of the first placing; development had 1,000,000."""
NOMINAL, PRESSES, FREE = 24, 24, 6
"""Presses that a bundle learns, and of each gel; pictures of the new gel."""


class Lift(NamedTuple):
    """What is seen of the free gel between two presses."""

    frames: int
    since_s: float
    """Since the release: what the press before has left behind fades meanwhile."""


LONG, BRIEF = Lift(6, 3.0), Lift(1, 0.15)
"""A lift of some seconds; the one frame that a lift of 0.3 s at ten frames a second gives."""
SCARRED_AT: Final = (4, 10, 16)
"""Presses before which a scar appears; the gel has its record of quiet presses then."""
DAMAGED_SHARE, SERIES = 0.35, 4
"""SERIES: pieces in a row with damage at one place, as from a broken tool: the hard case of a fixture."""
INSPECTED_MM, RANDOM_PART_DEPTH_MM = 6.3, 0.4
MOST_BLIND: Final = 0.05
"""The default of `gel.most_blind_share`: above it the gel is changed."""

MEANINGS: Final = {
    "scar": "a scar, the part is sound",
    "damage": "damage, without it the press passes",
    "both": "a scar and damage, each alone",
    "wear": "ordinary wear, the part is sound",
}
"""What raises an alarm. Without the scar, or without the damage, the press passes; wear is what the simulator adds to
every gel."""

CAUSES: Final = (Cause.GEL, Cause.UNSURE, Cause.PART)


@dataclass(frozen=True)
class Placing:
    """A part and how it is put under the gel."""

    part: str
    position: str
    """Empty for a random part."""
    jitter: Jitter
    is_registered: bool = False
    """Presses are brought to one pose."""

    @property
    def depth_mm(self) -> float:
        return PARTS[self.part].depth_mm if self.position else RANDOM_PART_DEPTH_MM

    def shape(self) -> HeightField:
        if not self.position:
            return random_part(np.random.default_rng(int(self.part.removeprefix("random"))))
        return PARTS[self.part].positions[self.position]


ANYWHERE: Final = Jitter(1.2, 8.0, 0.4, 0.06)

PLACINGS: Final = (
    Placing("PZ1", "pos1", PARTS["PZ1"].jitter),
    Placing("PZ3", "pos1", Jitter(0.02, 0.1, 0.1, 0.03)),
    Placing("random11", "", PARTS["PZ1"].jitter),
    Placing("PZ4", "pos1", PARTS["PZ4"].jitter),
    Placing("PZ2", "pos1", ANYWHERE, is_registered=True),
    Placing("PZ5", "pos1", ANYWHERE, is_registered=True),
)
"""Always at one place, the hard case: a thread, grooves, a random part; a bracket by hand; a connector and a pinion
anywhere."""


class Line:
    """One placing on one gel. seed: of pieces and marks."""

    def __init__(self, placing: Placing, seed: int, lift: Lift = LONG) -> None:
        self.lift, self.placing, self.seed = lift, placing, seed
        self.streams, self.shape = Streams(seed), placing.shape()
        effects = (*DEFAULT_EFFECTS, "residual_imprint")
        self._renderer = Renderer(LR, effects, jitter=placing.jitter, streams=self.streams)

    def imprint(self, piece: int, defect: Defect | None = None) -> F32:
        """Shape the gel over one piece, mm, float32 (240, 320)."""
        shape = specimen(self.shape, self.streams("specimen", piece))
        placed = self._renderer.place(Pose(), (piece,))
        height = sample(shape if defect is None else Damaged(shape, defect), placed, LR)
        return self._renderer.imprint(height, self.placing.depth_mm * placed.depth_factor)

    def press(self, imprint: F32, piece: int, age: int, scars: Shares = ()) -> U8:
        """Photograph a press, uint8 (240, 320, 3). age: presses of the gel."""
        light = self._light(self._renderer.surface(imprint, age), age, scars)
        return self._renderer.expose(light, (piece,), Exposure(0, age * PRESS_CYCLE_S))

    def free_gel(self, age: int, scars: Shares = (), before: F32 | None = None) -> View:
        """Show the free gel as the station sees it, float32 (120, 160, 3). before: the imprint of the last press."""
        flat = np.zeros(LR.shape, np.float32)
        left = None if before is None else (before, self.lift.since_s)
        light = self._light(self._renderer.surface(flat, age, left), age, scars)
        frames = [
            self._renderer.expose(light, ("free", age), Exposure(k, age * PRESS_CYCLE_S))
            for k in range(LONG.frames if before is None else self.lift.frames)
        ]
        return np.asarray(np.mean([as_view(one) for one in frames], axis=0), np.float32)

    def free_picture(self, number: int) -> U8:
        """Photograph the new gel, uint8 (240, 320, 3)."""
        return self._renderer.free_gel(("new", number))

    def _light(self, surface: F32, age: int, scars: Shares) -> F32:
        marked, coat = mark_gel(surface, scars, LR)
        return np.asarray(self._renderer.light(marked, age) * coat, np.float32)


def as_view(rgb: U8) -> View:
    """Shrink a picture to what contact detection sees, float32 (120, 160, 3)."""
    return np.asarray(cv2.resize(rgb.astype(np.float32), VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)


class Station:
    """A placing with a bundle that has learnt presses of sound pieces on the new gel."""

    def __init__(self, placing: Placing, seed: int, lift: Lift) -> None:
        line = self.line = Line(placing, seed, lift)
        sensor, detector = profile("cropped_lr"), registry.detector("padim")
        region = Region.centre(sensor.size)
        pictures = {
            f"s{piece:03d}_p0": line.press(line.imprint(piece), piece, piece) for piece in range(NOMINAL)
        }
        config = FitConfig(
            placing.part,
            placing.position or "top",
            sensor,
            region,
            detector,
            open_trunk("tactile_resnet18", detector.taps(detector.parameters())),
            threads=1,
            register="always" if placing.is_registered else "never",
        )
        free = [line.free_picture(k) for k in range(FREE)]
        presses = gather_presses(pictures, sensor, region, no_contact=free)
        self.scorer = Scorer(fit_files(presses, config, created="2026-01-01").bundle(), 1)
        self.first = line.free_gel(NOMINAL)

    def score(self, rgb: U8) -> Scored | None:
        """Score a picture; None where the part is not found."""
        return self._score(self._crop(rgb))

    def passes(self, rgb: U8, masked: Mask | None = None) -> bool:
        """Judge a picture. masked: bool (h, w), places that are not judged."""
        if (scored := self.score(rgb)) is None:
            return False
        rest = scored.score_map if masked is None else np.where(masked, -np.inf, scored.score_map)
        return bool(rest.max() <= self._limit(scored))

    def press(self, scored: Scored, rgb: U8, contact: Mask) -> ScoredPress:
        """Return the press as the gateway gives it to the record of the gel."""
        bundle, found = self.scorer.bundle, scored.registered
        cropped, size, region = self._crop(rgb), bundle.profile.size, bundle.region

        def score_map(change: View) -> F32 | None:
            again = self._score(without_marks(cropped, change, size, region))
            return None if again is None else again.score_map

        return ScoredPress(
            scored.score_map,
            self._limit(scored),
            region,
            size,
            bundle.profile.mm_per_pixel,
            contact,
            None if found is None else found.unseen_in_press,
            measure_moves(found, region, size, bundle.profile.mm_per_pixel),
            score_map,
        )

    def _crop(self, rgb: U8) -> U8:
        return np.ascontiguousarray(self.scorer.bundle.region.crop(rgb))

    def _score(self, cropped: U8) -> Scored | None:
        try:
            return self.scorer.score(cropped)
        except PoseNotFound:
            return None

    def _limit(self, scored: Scored) -> float:
        manifest = self.scorer.bundle.manifest
        return manifest.threshold.value - manifest.tolerance.around(scored.anomaly_score)


class Run:
    """One gel from its first press on, and those that follow it. gel: its number, which draws scars and damage."""

    def __init__(self, station: Station, gel: int) -> None:
        self.station, self.line, self.gel = station, station.line, gel
        self._rng = np.random.default_rng([station.line.seed, gel])
        self._scars: list[Scar] = []
        self._record = self._mount()
        self._series: list[Defect] = []

    def play(self) -> Iterator[tuple[str, Cause]]:
        """Make every press; gives what raised each alarm, and the cause that it was given."""
        line, before, left = self.line, None, None
        for number in range(PRESSES):
            piece, age = 1000 * (self.gel + 1) + number, NOMINAL + number
            if number in SCARRED_AT:
                self._add_scar(number, piece)
            defect, shares = self._draw_defect(piece), self._shares(number)
            imprint = line.imprint(piece, defect)
            free = line.free_gel(age, shares, before)
            rgb = line.press(imprint, piece, age, shares)
            if (scored := self.station.score(rgb)) is not None:
                contact = touched_mask(Reference(free).difference(as_view(rgb)))
                judged = self._record.judge(self.station.press(scored, rgb, contact), free, left)
                if judged.blame is not None:
                    truth = self._find_truth(judged, piece, age, defect, imprint, shares)
                    yield from [] if truth is None else [(truth, judged.blame.cause)]
                if judged.blind_share > MOST_BLIND:  # the station asks for a new gel
                    self._scars.clear()
                    self._record = self._mount()
            before, left = imprint, as_view(rgb) - free

    def _mount(self) -> GelScars:
        scars = GelScars(first=self.station.first)
        scars.is_fresh = self.line.lift is BRIEF
        return scars

    def _find_truth(
        self, judged: Judged, piece: int, age: int, defect: Defect | None, imprint: F32, shares: Shares
    ) -> str | None:
        """Say what an alarm is due to, by making the press again; None for a false alarm."""
        line, passes = self.line, self.station.passes
        if defect is not None:
            sound = line.press(line.imprint(piece), piece, age, shares)
            return "damage" if passes(sound, judged.masked) else "both"
        again = line.press(imprint, piece, age if shares else 0)
        return ("scar" if shares else "wear") if passes(again) else None

    def _shares(self, number: int) -> Shares:
        return tuple((one, one.share(number)) for one in self._scars)

    def _add_scar(self, number: int, piece: int) -> None:
        """Add a scar of the next kind, somewhere under the part."""
        kinds = tuple(SCARS)
        kind = kinds[(self.gel * len(SCARRED_AT) + SCARRED_AT.index(number)) % len(kinds)]
        rows, columns = np.nonzero(self.line.imprint(piece) > 0.1)
        at = int(self._rng.integers(len(rows)))
        x, y = grids(LR)
        spot = float(x[0, columns[at]]), float(y[rows[at], 0])
        inside = tuple(float(np.clip(value, -INSPECTED_MM, INSPECTED_MM)) for value in spot)
        self._scars.append(random_scar(kind, (inside[0], inside[1]), number, self._rng))

    def _draw_defect(self, piece: int) -> Defect | None:
        """Return the damage of this piece: none, its own, or the one that a broken tool makes on several."""
        if self._series:
            return self._series.pop()
        if self._rng.uniform() > DAMAGED_SHARE:
            return None
        kinds, line = tuple(DEFECTS), self.line
        defect = place_damage(
            line.shape,
            kinds[int(self._rng.integers(len(kinds)))],
            float(self._rng.uniform(0.3, 1.0)),
            line.placing.depth_mm,
            MASK_DEPTH_MM,
            line.streams("defect", piece),
        )
        if self._rng.uniform() < 1 / (2 * SERIES):
            self._series = [defect] * (SERIES - 1)
        return defect


def write_rate(number: int, of: int) -> str:
    """Write a rate with the limits of Clopper and Pearson, each crossed with a probability of 10 % at most."""
    if not of:
        return "- (0 of 0; 0.0% to 100.0%)"
    low, high = rate_limits(number, of)
    return f"{number / of:.1%} ({number} of {of}; {low:.1%} to {high:.1%})"


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("gels", nargs="?", type=int, default=4, help="of each placing")
    words.add_argument("--brief", action="store_true", help="lift for 0.3 s between presses")
    given, alarms = words.parse_args(), Counter[tuple[str, Cause]]()
    for number, placing in enumerate(PLACINGS):
        station = Station(placing, SEED + number, BRIEF if given.brief else LONG)
        for gel in range(given.gels):
            alarms.update(Run(station, gel).play())
    lines = []
    for truth, meaning in MEANINGS.items():
        total = sum(alarms[truth, cause] for cause in CAUSES)
        lines.append([meaning, total, *(write_rate(alarms[truth, cause], total) for cause in CAUSES)])
    print(markdown_table(["alarm raised by", "alarms", *(f"`{cause.value}`" for cause in CAUSES)], lines))


if __name__ == "__main__":
    main()
