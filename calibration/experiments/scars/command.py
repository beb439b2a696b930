"""Runs of a simulated line: every press is judged as a station judges it, and the truth is known of each alarm.

What raises an alarm is known by making the press again, without the scars or without the damage.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.rows import write_json
from calibration.experiments.harness.study import require_known
from calibration.experiments.scars.worn_gel import PLACINGS, Line, Placing, as_view
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.folders import require_folder
from calibration.progress import progress
from calibration.simulator.defects import DEFECTS, Defect
from calibration.simulator.field_of_view import F32, LR, grids
from calibration.simulator.plan import place_damage
from calibration.simulator.renderer import MASK_DEPTH_MM
from calibration.simulator.scars import SCARS, Scar, random_scar
from edge import registry
from edge.core.binomial import rate_limits
from edge.core.contact.mask import touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.errors import PoseNotFound
from edge.core.gel_scars.gel_scars import GelScars, Judged
from edge.core.gel_scars.press import ScoredPress, without_marks
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.core.verdict import Cause
from edge.model.scorer import Scored, Scorer

__all__ = ["MEANINGS", "Alarm", "Run", "Station", "evaluate_scars", "format_rate", "table"]

U8 = NDArray[np.uint8]

# Seeds of the placings in each set; development and judgement share no press.
SEEDS = {"development": 1_000_000, "judgement": 6_000_000}
NOMINAL: Final = 24
PRESSES: Final = 24
# Presses before which a scar appears; the gel has its record of quiet presses then.
_SCARRED_AT: Final = (4, 10, 16)
_DAMAGED_SHARE: Final = 0.35
# Pieces in a row with damage at one place, as from a broken tool: the hard case of a fixture.
_SERIES: Final = 4
_INSPECTED_MM: Final = 6.3
_METHOD: Final = "padim"
_BACKBONE: Final = "tactile_resnet18"
# The default of `gel.most_blind_share`: above it the gel is changed.
MOST_BLIND: Final = 0.05

Alarm = Mapping[str, Any]
"""One press that did not pass: placing, gel, press, truth (in `MEANINGS`), cause, what (the kinds of scar or damage),
blind_share."""

MEANINGS: Final = {
    "scar": "a scar, the part is sound",
    "damage": "damage, without it the press passes",
    "both": "a scar and damage, each alone",
    "wear": "ordinary wear, the part is sound",
}
"""What raises an alarm, in words. Without the scar, or without the damage, the press passes; wear is what the simulator
adds to every gel."""


class Station:
    """A placing with a bundle that has learnt 24 presses of sound pieces on the new gel."""

    def __init__(self, placing: Placing, seed: int) -> None:
        line = self.line = Line(placing, seed)
        sensor, detector = profile("cropped_lr"), registry.detector(_METHOD)
        region = Region.centre(sensor.size)
        pictures = {
            f"s{piece:03d}_p0": line.press(line.imprint(piece), piece, piece) for piece in range(NOMINAL)
        }
        free = [line.free_picture(k) for k in range(_FREE)]
        config = FitConfig(
            placing.part,
            placing.position or "top",
            sensor,
            region,
            detector,
            open_trunk(_BACKBONE, detector.taps(detector.parameters())),
            threads=1,
            register="always" if placing.is_registered else "never",
        )
        presses = gather_presses(pictures, sensor, region, no_contact=free)
        self.scorer = Scorer(fit_files(presses, config, created="2026-01-01").bundle(), 1)
        self.first = line.free_gel(NOMINAL)

    def score(self, rgb: U8) -> Scored | None:
        """Score a picture; None where the part is not found."""
        return self._score(self._crop(rgb))

    def passes(self, scored: Scored | None, masked: NDArray[np.bool_] | None = None) -> bool:
        """masked: bool (h, w), places that are not judged."""
        if scored is None:
            return False
        rest = scored.score_map if masked is None else np.where(masked, -np.inf, scored.score_map)
        return bool(rest.max() <= self._limit(scored))

    def press(self, scored: Scored, rgb: U8, contact: NDArray[np.bool_]) -> ScoredPress:
        """Return the press as the gateway gives it to the record of the gel."""
        bundle, found = self.scorer.bundle, scored.registered
        x_mm, y_mm = bundle.profile.mm_per_pixel
        cropped, size, region = self._crop(rgb), bundle.profile.size, bundle.region

        def score_map(change: View) -> F32 | None:
            again = self._score(without_marks(cropped, change, size, region))
            return None if again is None else again.score_map

        return ScoredPress(
            scored.score_map,
            self._limit(scored),
            region,
            size,
            (x_mm, y_mm),
            contact,
            None if found is None else found.unseen_in_press,
            None if found is None else (found.pose.x_px * x_mm, found.pose.y_px * y_mm),
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


_FREE: Final = 6


@dataclass(frozen=True, eq=False)
class _Pressed:
    """One press of a run. age: presses of the gel before it."""

    number: int
    piece: int
    age: int
    defect: Defect | None
    imprint: F32


class Run:
    """One gel from its first press on, and those that follow it."""

    def __init__(self, station: Station, gel: int, flattened: float = 0.0) -> None:
        """gel: its number, which draws scars, damage and order. flattened: of a scar, by contact, 0 to 1."""
        self.station, self.gel, self.flattened = station, gel, flattened
        self.alarms: list[Alarm] = []
        self.presses = 0
        self._rng = np.random.default_rng([station.line.seed, gel])
        self._scars: list[Scar] = []
        self._record = GelScars(first=station.first)
        self._series: list[Defect] = []

    def play(self) -> "Run":
        """Make every press; returns itself."""
        line, before, left = self.station.line, None, None
        for number in range(PRESSES):
            piece, age = 1000 * (self.gel + 1) + number, NOMINAL + number
            self._scar(number, piece)
            defect = self._defect(piece)
            press = _Pressed(number, piece, age, defect, line.imprint(piece, defect))
            free = line.free_gel(age, self._shares(number), before)
            rgb = line.press(press.imprint, piece, age, self._scars_at(number))
            if (scored := self.station.score(rgb)) is not None:
                self.presses += 1
                contact = touched_mask(Reference(free).difference(as_view(rgb)))
                self._add(press, self._record.judge(self.station.press(scored, rgb, contact), free, left))
            before, left = press.imprint, as_view(rgb) - free
        return self

    def _add(self, press: _Pressed, judged: Judged) -> None:
        """Keep an alarm that is due to something; the station asks for a new gel where too much is blind."""
        if judged.blame is not None and (truth := self._truth(press, judged)) is not None:
            scars = "+".join(sorted({one.kind for one in self._scars})) or "-"
            self.alarms.append(
                {
                    "placing": self.station.line.placing.name,
                    "gel": self.gel,
                    "press": press.number,
                    "truth": truth,
                    "cause": judged.blame.cause.value,
                    "what": press.defect.kind if press.defect else scars,
                    "blind_share": judged.blind_share,
                }
            )
        if judged.blind_share > MOST_BLIND:
            self._scars.clear()
            self._record = GelScars(first=self.station.first)

    def _truth(self, press: _Pressed, judged: Judged) -> str | None:
        """Say what an alarm is due to, by making the press again; None for a false alarm."""
        line, shares = self.station.line, self._scars_at(press.number)
        if press.defect is not None:
            sound = line.press(line.imprint(press.piece), press.piece, press.age, shares)
            return "damage" if self._passes(sound, judged.masked) else "both"
        again = line.press(press.imprint, press.piece, press.age if shares else 0)
        return ("scar" if shares else "wear") if self._passes(again) else None

    def _passes(self, rgb: U8, masked: NDArray[np.bool_] | None = None) -> bool:
        return self.station.passes(self.station.score(rgb), masked)

    def _shares(self, number: int) -> tuple[tuple[Scar, float], ...]:
        return tuple((one, one.share(number)) for one in self._scars)

    def _scars_at(self, number: int) -> tuple[tuple[Scar, float], ...]:
        """Return the scars as a press shows them."""
        return tuple((one, share * (1 - self.flattened)) for one, share in self._shares(number))

    def _scar(self, number: int, piece: int) -> None:
        """A new scar of the next kind, somewhere under the part."""
        if number not in _SCARRED_AT:
            return
        kinds = tuple(SCARS)
        kind = kinds[(self.gel * len(_SCARRED_AT) + _SCARRED_AT.index(number)) % len(kinds)]
        rows, columns = np.nonzero(self.station.line.imprint(piece) > 0.1)
        at = int(self._rng.integers(len(rows)))
        x, y = grids(LR)
        spot = float(x[0, columns[at]]), float(y[rows[at], 0])
        inside = tuple(float(np.clip(value, -_INSPECTED_MM, _INSPECTED_MM)) for value in spot)
        self._scars.append(random_scar(kind, (inside[0], inside[1]), number, self._rng))

    def _defect(self, piece: int) -> Defect | None:
        """Return the damage of this piece: none, its own, or the one that a broken tool makes on several."""
        if self._series:
            return self._series.pop()
        if self._rng.uniform() > _DAMAGED_SHARE:
            return None
        kinds, line = tuple(DEFECTS), self.station.line
        defect = place_damage(
            line.shape,
            kinds[int(self._rng.integers(len(kinds)))],
            float(self._rng.uniform(0.3, 1.0)),
            line.placing.depth_mm,
            MASK_DEPTH_MM,
            line.streams("defect", piece),
        )
        if self._rng.uniform() < 1 / (2 * _SERIES):
            self._series = [defect] * (_SERIES - 1)
        return defect


def format_rate(number: int, of: int) -> str:
    """Write a rate with the limits of Clopper and Pearson, each crossed with a probability of 10 % at most."""
    if not of:
        return "- (0 of 0; 0.0% to 100.0%)"
    low, high = rate_limits(number, of)
    return f"{number / of:.1%} ({number} of {of}; {low:.1%} to {high:.1%})"


def table(alarms: Sequence[Alarm], presses: int) -> str:
    """Write Markdown: all alarms by what raised them, then scars and damage by placing, and by kind."""
    lines = []
    for truth, meaning in MEANINGS.items():
        causes = Counter(one["cause"] for one in alarms if one["truth"] == truth)
        rates = [format_rate(causes[cause.value], causes.total()) for cause in _CAUSES]
        lines.append([meaning, causes.total(), *rates])
    return "\n".join(
        [
            f"{presses} presses, {len(alarms)} alarms; limits hold with 90 % each.\n",
            markdown_table(["alarm raised by", "alarms", *(f"`{cause.value}`" for cause in _CAUSES)], lines),
            _count_named_gel("placing", alarms, "placing"),
            _count_named_gel("kind of damage, or scars so far", alarms, "what"),
        ]
    )


_CAUSES = (Cause.GEL, Cause.UNSURE, Cause.PART)


def _count_named_gel(what: str, alarms: Sequence[Alarm], column: str) -> str:
    """Count how many of the scar and of the damage alarms were named gel."""
    counts = Counter((one[column], one["truth"], one["cause"] == Cause.GEL) for one in alarms)
    lines = [
        [
            name,
            *(
                f"{(gel := counts[name, truth, True])} of {gel + counts[name, truth, False]}"
                for truth in ("scar", "damage")
            ),
        ]
        for name in sorted({one[column] for one in alarms})
    ]
    return markdown_table([what, "scar alarms named `gel`", "damage alarms named `gel`"], lines)


def evaluate_scars(
    which: Annotated[
        str, typer.Option("--set", help="development, or judgement: gels apart.")
    ] = "development",
    gels: Annotated[int, typer.Option(help="Gels of each placing.", min=1, max=1000)] = 4,
    placing: Annotated[
        list[str] | None, typer.Option(help="These placings only, such as 'thread in a fixture'.")
    ] = None,
    flattened: Annotated[
        float, typer.Option(help="Share of a scar that contact presses flat.", min=0, max=0.9)
    ] = 0.0,
    json: Annotated[Path | None, typer.Option(help="Write every alarm to this JSON file.")] = None,
) -> None:
    """How scars of the gel and damage are distinguished.

    On simulated worn gels with scratches, dents, hairs and worn coat: six ways to place parts, with a bundle each.
    Prints the cause that each alarm was given, by what raised it, with exact binomial limits."""
    require_known("set", [which], SEEDS)
    require_known("placing", placing or (), PLACINGS)
    require_folder(json)
    chosen = [(k, one) for k, one in enumerate(PLACINGS.values()) if not placing or one.name in placing]
    runs: list[Run] = []
    with progress("gels", gels * len(chosen)) as advance:
        for number, one in chosen:
            station = Station(one, SEEDS[which] + number)
            for gel in range(gels):
                runs.append(Run(station, gel, flattened).play())
                advance(len(runs))
    alarms = [alarm for run in runs for alarm in run.alarms]
    typer.echo(table(alarms, sum(run.presses for run in runs)))
    write_json(json, alarms)
