"""How far one, two, four or more presses get, with and without rendered copies: the table of docs/detectors.md.

Run with `pytest tests/bench/test_few_presses.py -m bench -s`. Ten random parts on which nothing was chosen. Each press
is of another piece; smaller draws are part of larger ones. 20 sound and 20 damaged presses of further pieces are
scored. A quarter of an hour of one quiet core.

FEW_PRESSES_SEEDS=10 draws the presses of each part ten times; in the draws after the first, only what a fit without
options does is measured, and no limit, and with FEW_PRESSES_METHODS=padim,patchcore these methods alone. With
FEW_PRESSES_CACHE naming a folder each row is kept there, and a run that was cut goes on; FEW_PRESSES_SEEDS=0 prints
what is there.
"""

import itertools
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from random_part_presses import RandomPartPresses

from calibration.fitting.augmentation import EACH, MOST, Copies, augmentation_of, rendered_copies
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.folds import held_out_folds
from calibration.fitting.held_out import Learner, held_out_scores
from calibration.fitting.nominal_presses import NominalPresses, named_presses
from calibration.fitting.threshold import MIN_PRESSES, conformal_threshold, of_copies
from calibration.fitting.trunks import open_trunk
from calibration.metrics import aupro, auroc
from calibration.studies.intervals import mean_interval
from edge import registry
from edge.core.detector import Features, Grid, Nominal
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.session import open_session

pytestmark = pytest.mark.bench

INSTEAD: Mapping[str, tuple[str, Mapping[str, object]]] = {
    "one press as it is, padim": ("padim", {}),
    "a covariance shared by 8x8 cells": ("padim", {"block": 8}),
    "a covariance shared by 28x28 cells": ("padim", {"block": 28}),
    "one press as it is, spade": ("spade", {}),
    "matches within 1 mm": ("spade", {"window_mm": 1.0}),
    "matches within 1.5 mm": ("spade", {"window_mm": 1.5}),
}
"""Settings that tolerate more, tried on development parts instead of copies."""
METHODS = ("padim", "spade", "fapm", "inreach", "patchcore", "subspace")
# Of judgement, opened once, when everything was settled; and of development.
SHAPES, PARTS = 5502, 10
DEVELOPMENT, DEVELOPMENT_PARTS = 5501, 3
SHOTS = (1, 2, 4, 8, 16, 32)
ROW = ("part", "seed", "shots", "copied", "method")
MOST_COPIED, MOST_LIMITED = 8, 4
"""Presses up to which copies are tried, and thresholds are found."""
SCORED, FREE = 20, 4
SEEDS = int(os.environ.get("FEW_PRESSES_SEEDS", "1"))
DRAWN_AGAIN = os.environ.get("FEW_PRESSES_METHODS", ",".join(METHODS)).split(",")
ALPHA = 0.05
PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)
TAPS = ("layer1", "layer2")


class Part:
    """The presses of one random part and their features."""

    def __init__(self, shapes: int, number: int) -> None:
        self._simulated = RandomPartPresses(shapes, number, max(SHOTS) + 2 * SCORED)
        self._session = open_session(open_trunk("tactile_resnet18", TAPS).graph, 1, "trunk")
        self.grid = trunk_grid(self._session, TAPS, (REGION.height, REGION.width), PROFILE.pixels_per_mm)

    def features(self, frames: NDArray[np.uint8]) -> Features:
        return extract(self._session, frames, self.grid, lambda done: None)

    @cached_property
    def scored(self) -> tuple[Features, list[NDArray[np.bool_]]]:
        """Sound presses, then damaged ones, and the damage of each."""
        first = max(SHOTS)
        sound = [self._simulated.press(1000 + k, 1, first + k) for k in range(SCORED)]
        damaged = [self._simulated.damaged(2000 + k, first + SCORED + k) for k in range(SCORED)]
        frames = [REGION.crop(rgb) for rgb in (*sound, *(rgb for rgb, _ in damaged))]
        none = np.zeros((REGION.height, REGION.width), np.bool_)
        return self.features(np.stack(frames)), [none] * SCORED + [REGION.crop(mask) for _, mask in damaged]

    def pool(self, seed: int) -> list[NDArray[np.uint8]]:
        """The presses of one draw: other pieces, at other moments of the gel's life."""
        most = max(SHOTS)
        return [self._simulated.press(100 * seed + k, 1, (k + seed) % most) for k in range(most)]

    @cached_property
    def free(self) -> list[NDArray[np.uint8]]:
        return [self._simulated.free_gel(number) for number in range(FREE)]


class Draw:
    """One draw of a part's presses."""

    def __init__(self, part: Part, seed: int) -> None:
        self.part, self.seed = part, seed

    @cached_property
    def _pool(self) -> list[NDArray[np.uint8]]:
        return self.part.pool(self.seed)

    def presses(self, shots: int) -> NominalPresses:
        drawn = {f"part_pos_s{k:03d}_p01": rgb for k, rgb in enumerate(self._pool[:shots])}
        return named_presses(drawn, PROFILE, REGION, no_contact=self.part.free)


class Fit:
    """Presses of a draw with or without copies; each method is fitted on the same features."""

    def __init__(self, draw: Draw, shots: int, is_copied: bool) -> None:
        part, self._is_first = draw.part, draw.seed == 0
        self._part, self._presses = part, draw.presses(shots)
        assert self._presses.no_contact is not None
        self._nominal = part.features(self._presses.frames)
        self._free = part.features(self._presses.no_contact)
        self._copies = self._rendered(min(EACH, MOST // shots), 0) if is_copied else None
        is_fresh = is_copied and shots == 1 and self._is_first
        self._fresh = self._rendered(EACH, 1) if is_fresh else None

    def _rendered(self, each: int, seed: int) -> Copies:
        rng = np.random.default_rng(seed)
        frames, of = rendered_copies(self._presses, each, PROFILE.pixels_per_mm, rng)
        return Copies(self._part.features(frames), of)

    def measured(self, method: str, **changes: object) -> dict[str, Any]:
        """Image AUROC, AU-PRO, and the scores from which a limit is found. changes: of the method's parameters."""
        detector = registry.detector(method)
        parameters = detector.parameters("corrected", **changes)
        taps = detector.taps(parameters)

        def read(features: Features) -> Features:
            return {tap: features[tap] for tap in taps}

        grid = Grid(self._part.grid.frame, read(self._part.grid.taps), self._part.grid.pixels_per_mm)  # type: ignore[arg-type]
        copies = None if self._copies is None else Copies(read(self._copies.features), self._copies.press)
        learner = Learner(detector, grid, parameters, 0, 1, copies)
        nominal = Nominal(read(self._nominal), self._presses.touched, read(self._free))
        bank = learner.bank(nominal)
        features, masks = self._part.scored
        found = learner.scored(bank, read(features), range(len(masks)))
        fresh = []
        if self._fresh is not None:
            fresh = learner.scores(bank, read(self._fresh.features), range(EACH)).tolist()
        is_limited = 1 < nominal.presses <= MOST_LIMITED and (copies or nominal.presses >= MIN_PRESSES)
        held_out = self._held_out(learner, nominal) if is_limited and self._is_first else []
        return {
            "auroc": auroc(found.scores, np.array([mask.any() for mask in masks])),
            "aupro": aupro(found.maps, masks),
            "scores": found.scores.tolist(),
            "fresh": fresh,
            "held_out": held_out,
        }

    def _held_out(self, learner: Learner, nominal: Nominal) -> list[float]:
        folds, said = held_out_folds(self._presses.specimens, 5, np.random.default_rng(0), 2)
        assert not said
        found: list[float] = held_out_scores(learner, nominal, folds).tolist()
        return found


def rows(
    shapes: int = SHAPES, parts: Sequence[int] = range(PARTS), seeds: int = SEEDS
) -> list[dict[str, Any]]:
    """A row per part, seed, shots, with and without copies, and method; those in the cache are not measured again."""
    folder = os.environ.get("FEW_PRESSES_CACHE")
    file = Path(folder) / f"rows_{shapes}.jsonl" if folder else None
    found = [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []
    known = {tuple(row[name] for name in ROW) for row in found}
    for seed, number in itertools.product(range(seeds), parts):
        draw = Draw(Part(shapes, number), seed)
        for shots, is_copied in designs():
            methods = [
                method
                for method in METHODS
                if (number, seed, shots, is_copied, method) not in known
                and (seed == 0 or is_drawn_again(method, shots, is_copied))
            ]
            fit = Fit(draw, shots, is_copied) if methods else None
            for method in methods if fit else ():
                key = dict(zip(ROW, (number, seed, shots, is_copied, method), strict=True))
                found.append({**key, **fit.measured(method)})
                if file:
                    with file.open("a") as out:
                        out.write(json.dumps(found[-1]) + "\n")
    return found


def designs() -> Iterator[tuple[int, bool]]:
    """Every number of presses without copies, and the few with them."""
    for shots in SHOTS:
        yield shots, False
        if shots <= MOST_COPIED:
            yield shots, True


def is_drawn_again(method: str, shots: int, is_copied: bool) -> bool:
    return method in DRAWN_AGAIN and is_copied == is_copied_by_default(method, shots)


@cache
def is_copied_by_default(method: str, shots: int) -> bool:
    """Whether a fit without options adds copies."""
    frames = np.zeros((shots, 8, 8, 3), np.uint8)
    presses = NominalPresses(frames, tuple(map(str, range(shots))), no_contact=frames[:1])
    return augmentation_of("auto", presses, method, "corrected").each > 0


def at_the_limit(row: Mapping[str, Any]) -> tuple[float, float] | None:
    """The shares of damaged and of sound presses above the fitted limit; None where none is measured."""
    if row["fresh"]:
        limit = of_copies(row["fresh"], ALPHA)
    elif row["held_out"]:
        limit = conformal_threshold(row["held_out"], ALPHA, fewest=2)
    else:
        return None
    is_above = np.array(row["scores"]) > limit.value
    return float(is_above[SCORED:].mean()), float(is_above[:SCORED].mean())


def line(found: Sequence[Mapping[str, Any]], method: str, shots: int, is_copied: bool) -> str:
    """A line of the table: means over the parts, with 95 % intervals."""
    chosen = first_draws(found, method, shots, is_copied)
    cells = []
    for measure in ("auroc", "aupro"):
        values = [row[measure] for row in chosen]
        low, high = mean_interval(np.array(values))
        cells.append(f"{np.mean(values):.3f} ({low:.2f} to {high:.2f})")
    limits = [one for one in map(at_the_limit, chosen) if one]
    shares = [f"{share:.0%}" for share in np.mean(limits, axis=0)] if limits else ["", ""]
    return f"| {method} | {shots} | {'copies' if is_copied else 'presses'} | {' | '.join(cells + shares)} |"


def first_draws(
    found: Sequence[Mapping[str, Any]], method: str, shots: int, is_copied: bool
) -> list[Mapping[str, Any]]:
    wanted = (0, method, shots, is_copied)
    return [row for row in found if (row["seed"], row["method"], row["shots"], row["copied"]) == wanted]


def seed_lines(found: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The curve over the seeds that every part has, as a fit without options learns: means over parts and seeds, the
    interval over the seeds' means, and how far two draws of one part are apart (standard deviation)."""
    for method, shots in itertools.product(METHODS, SHOTS):
        copied = is_copied_by_default(method, shots)
        tables = [by_seed(found, (shots, copied, method), measure) for measure in ("auroc", "aupro")]
        if len(tables[0]) > 1:
            bank = "copies" if copied else "presses"
            cells = " | ".join(map(_over_seeds, tables))
            yield f"| {method} | {shots} | {bank} | {len(tables[0])} | {cells} |"


def _over_seeds(table: NDArray[np.float64]) -> str:
    """table: of a measure, (seeds, parts)."""
    low, high = mean_interval(table.mean(axis=1))
    apart = float(np.sqrt(table.var(axis=0, ddof=1).mean()))
    return f"{table.mean():.3f} ({low:.3f} to {high:.3f}) | {apart:.3f}"


def by_seed(
    found: Sequence[Mapping[str, Any]], wanted: tuple[int, bool, str], measure: str
) -> NDArray[np.float64]:
    """One measure, (seeds, parts), of the seeds that every part has. wanted: shots, copied, method."""
    values = {
        (row["seed"], row["part"]): row[measure]
        for row in found
        if (row["shots"], row["copied"], row["method"]) == wanted
    }
    seeds = [seed for seed in range(100) if all((seed, part) in values for part in range(PARTS))]
    return np.array([[values[seed, part] for part in range(PARTS)] for seed in seeds])


def clamped_lines(found: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The table of parts in a fixture and of those that a hand clamps: image AUROC / AU-PRO."""
    yield "| method | clamped | 1 | 1, copies | 4, copies | 8 | 8, copies | 32 | sound failed, 1, copies |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for method in METHODS:
        for place, by in enumerate(("by hand", "in a fixture")):
            cells = []
            for shots, is_copied in ((1, False), (1, True), (4, True), (8, False), (8, True), (32, False)):
                rows = [
                    row for row in first_draws(found, method, shots, is_copied) if row["part"] % 2 == place
                ]
                cells.append(_means(rows).replace(" | ", " / "))
                if (shots, is_copied) == (1, True):
                    failed = np.mean([limit[1] for limit in map(at_the_limit, rows) if limit])
            cells.append(f"{failed:.0%}")
            yield f"| {method} | {by} | {' | '.join(cells)} |"


def test_few_presses() -> None:
    """Prints the tables."""
    cv2.setNumThreads(1)
    found = rows()
    print(
        "\n| method | presses | bank of | image AUROC | AU-PRO@0.01 | damaged found | sound failed |\n"
        "|---|---|---|---|---|---|---|"
    )
    for method in METHODS:
        for shots, is_copied in designs():
            print(line(found, method, shots, is_copied))
    print("", *clamped_lines(found), sep="\n")
    print(
        "\n| method | presses | bank of | seeds | image AUROC | apart | AU-PRO@0.01 | apart |\n"
        "|---|---|---|---|---|---|---|---|",
        *seed_lines(found),
        sep="\n",
    )
    assert all(np.isfinite(row["aupro"]) for row in found)


def test_instead_of_copies() -> None:
    """Prints what other settings give for one press, and copies with the usual ones."""
    parts = [Part(DEVELOPMENT, number) for number in range(DEVELOPMENT_PARTS)]
    one, copied = ([Fit(Draw(part, 0), 1, is_copied) for part in parts] for is_copied in (False, True))
    print("\n| what | image AUROC | AU-PRO@0.01 |\n|---|---|---|")
    for what, (method, changes) in INSTEAD.items():
        print(f"| {what} | {_means([fit.measured(method, **changes) for fit in one])} |")
    for method in ("padim", "spade"):
        print(f"| copies, {method} | {_means([fit.measured(method) for fit in copied])} |")


def _means(found: Sequence[Mapping[str, Any]]) -> str:
    values = [float(np.mean([row[measure] for row in found])) for measure in ("auroc", "aupro")]
    assert np.isfinite(values).all()
    return " | ".join(f"{value:.3f}" for value in values)
