"""1,000 simulated acquisitions on parts that no setting was chosen on: the tables of docs/acquire.md.

Run with `make acquisitions`, about half an hour on one quiet core. Twenty random parts; of each 40 nominal presses, of
40 pieces or of 10 pieces with 4 presses each, taken in 25 random orders; 100 presses of 100 other pieces for the true
rate of false alarms; and damaged presses. An acquisition takes presses until `gelgate bundle acquire` calls them
enough; then they are fitted as `gelgate fit` does.

The settings (PAYS, ROUND, EARLIEST, MOST_CELLS, the rule of near) were chosen on parts of another seed, 99, and the
parts of this one were opened once, after everything was settled.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pytest
from acquisition_tables import tables, write_rows
from numpy.typing import NDArray
from random_part_presses import RandomPartPresses

from calibration.acquisition.coverage import ROUND, PlaceDistances, Standing
from calibration.fitting.features import extract, trunk_grid
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, covering_bank, score_held_out
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.trunks import open_trunk
from calibration.metrics.pixel import aupro
from edge import registry
from edge.core.detector import Bank, Features, Grid, Nominal
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.model.packing import pack, unpack
from edge.model.session import open_session

pytestmark = pytest.mark.bench

SHAPES, PARTS, ORDERS = 8128, 20, 25
METHOD, ALPHA, FOLDS = "padim", 0.05, 5
# Sound presses beside the damaged ones for AU-PRO.
SOUND = 20


PROFILE = profile("cropped_lr")
SIDE = 80
TAPS = ("layer1", "layer2")


@dataclass(frozen=True)
class Sizes:
    """nominal: presses that an acquisition may take. each: presses of each piece. fresh: sound presses of other pieces
    for the true rate of false alarms. damaged: presses with a mask."""

    nominal: int = 40
    each: int = 1
    fresh: int = 100
    damaged: int = 16
    free: int = 4


SIZES = {"presses": Sizes(), "pieces": Sizes(each=4)}


@dataclass(frozen=True)
class Pool:
    """One part. nominal: all presses that may be taken. fresh, damaged: features of presses that are only scored."""

    presses: NominalPresses
    nominal: Nominal
    grid: Grid
    fresh: Features
    damaged: Features
    masks: NDArray[np.bool_]


def _draw_frames(shapes: int, number: int, sizes: Sizes) -> dict[str, NDArray[np.generic]]:
    """The pictures of one part, uint8 (n, h, w, 3) of the whole sensor, and the masks, bool (n, h, w)."""
    part = RandomPartPresses(shapes, number, sizes.nominal + sizes.fresh + sizes.damaged)
    orders = iter(range(sizes.nominal + sizes.fresh + sizes.damaged))
    nominal = [part.press(k // sizes.each, 1 + k % sizes.each, next(orders)) for k in range(sizes.nominal)]
    fresh = [part.press(1000 + k, 1, next(orders)) for k in range(sizes.fresh)]
    damaged = [part.damaged(2000 + k, next(orders)) for k in range(sizes.damaged)]
    return {
        "nominal": np.stack(nominal),
        "fresh": np.stack(fresh),
        "damaged": np.stack([rgb for rgb, _ in damaged]),
        "masks": np.stack([mask for _, mask in damaged]),
        "free": np.stack([part.free_gel(k) for k in range(sizes.free)]),
    }


def make_pool(shapes: int, number: int, sizes: Sizes) -> Pool:
    """The part's presses with their features."""
    frames = _draw_frames(shapes, number, sizes)
    names = [f"part_pos_s{k // sizes.each:03d}_p{1 + k % sizes.each:02d}.png" for k in range(sizes.nominal)]
    pictures, free = dict(zip(names, frames["nominal"], strict=True)), list(frames["free"])
    region = _around(gather_presses(pictures, PROFILE, Region.full(PROFILE.size), no_contact=free))
    presses = gather_presses(pictures, PROFILE, region, no_contact=free)
    session = open_session(open_trunk("tactile_resnet18", TAPS).graph, 1, "trunk")
    grid = trunk_grid(session, TAPS, (SIDE, SIDE), PROFILE.pixels_per_mm)

    def features(pictures: NDArray[np.uint8]) -> Features:
        return extract(session, np.stack([region.crop(rgb) for rgb in pictures]), grid, lambda done: None)

    nominal = Nominal(features(frames["nominal"]), presses.touched, features(frames["free"]))
    masks = np.stack([region.crop(mask) for mask in frames["masks"]])
    return Pool(presses, nominal, grid, features(frames["fresh"]), features(frames["damaged"]), masks)


def _around(presses: NominalPresses) -> Region:
    """A square of SIDE pixels around the middle of the contacts, inside the picture."""
    width, height = PROFILE.size
    x = round(float(np.mean([touch.x for touch in presses.touches])) * width - SIDE / 2)
    y = round(float(np.mean([touch.y for touch in presses.touches])) * height - SIDE / 2)
    return Region(min(max(x, 0), width - SIDE), min(max(y, 0), height - SIDE), SIDE, SIDE)


class Part:
    """One part's pool, and everything that is the same for all its acquisitions."""

    def __init__(self, pool: Pool) -> None:
        detector = registry.detector(METHOD)
        parameters = detector.parameters()
        self._taps = detector.taps(parameters)
        grid = Grid(
            pool.grid.frame, {tap: pool.grid.taps[tap] for tap in self._taps}, pool.grid.pixels_per_mm
        )
        self.pool, self._learner = pool, Learner(detector, grid, parameters, 0, 1)
        # Damage outside the region shows nothing.
        self._shown = np.flatnonzero(pool.masks.any(axis=(1, 2)))
        self.all = self.accuracy(self._learner.bank(self._nominal(np.arange(len(pool.presses)))))

    def _nominal(self, taken: NDArray[np.int64]) -> Nominal:
        whole = self.pool.nominal
        assert whole.no_contact is not None
        return replace(
            whole,
            features={tap: whole.features[tap][taken] for tap in self._taps},
            no_contact={tap: whole.no_contact[tap] for tap in self._taps},
        )

    def accuracy(self, bank: Bank) -> float:
        """AU-PRO up to 1 % false positives."""
        masks = [*self.pool.masks[self._shown], *np.zeros((SOUND, *self.pool.masks.shape[1:]), np.bool_)]
        maps = [
            *self._maps(bank, self.pool.damaged, self._shown),
            *self._maps(bank, self.pool.fresh, range(SOUND)),
        ]
        found = aupro(maps, masks)
        assert found is not None
        return found

    def _maps(self, bank: Bank, features: Features, rows: Sequence[int] | NDArray[np.int64]) -> list[Any]:
        head = open_session(self._learner.head(bank), 1, "head")
        wanted = {i.name for i in head.get_inputs()}
        stored = {name: _stored(bank, name) for name in bank.arrays if name in wanted}
        taps = [tap for tap in self._taps if tap in wanted]
        return [
            head.run(["score_map"], {**{tap: features[tap][[k]] for tap in taps}, **stored})[0][0]
            for k in rows
        ]

    def fitted(self, taken: NDArray[np.int64]) -> dict[str, Any]:
        """What a bundle of these presses promises and does."""
        specimens = [self.pool.presses.specimens[k] for k in taken]
        folds, _ = divide_presses(specimens, FOLDS, np.random.default_rng(0))
        covered = covering_bank(
            self._learner,
            self._nominal(taken),
            lambda roomy: (self._learner.bank(roomy), score_held_out(self._learner, roomy, folds)),
            lambda scores: conformal_threshold(scores, ALPHA, specimens=specimens).value,
        )
        assert covered.scores is not None
        limit = conformal_threshold(covered.scores, ALPHA, specimens=specimens)
        fresh = self._learner.score(
            covered.bank, self.pool.fresh, range(len(next(iter(self.pool.fresh.values()))))
        ).scores
        assert limit.by_press is not None
        return {
            "by_press": limit.by_press.rate,
            "by_piece": (limit.by_piece or limit.by_press).rate,
            "false_alarms": float(np.mean(fresh > limit.value)),
            "aupro": self.accuracy(covered.bank),
            "aupro_all": self.all,
        }


def _stored(bank: Bank, name: str) -> NDArray[Any]:
    packing = bank.packing.get(name, "none")
    return unpack(pack(bank.arrays[name], packing), packing)


def acquisition(pool: Pool, order: Sequence[int]) -> dict[str, Any]:
    """Press by press until it is enough. forecasts: [presses seen, presses forecast in all] after every round.
    covered: the presses after which more did not pay; it may come before the end, and is None if it never came."""
    distances, forecasts, covered, stop = PlaceDistances(), list[tuple[int, int]](), None, None
    names = pool.presses.specimens
    assert pool.presses.touched is not None
    for count, press in enumerate(order, start=1):
        distances.add(pool.nominal.features["layer1"][press], pool.presses.touched, names[press])
        standing = Standing(count, None, distances.coverage())
        if covered is None and standing.is_covered:
            covered = count
        if count % ROUND == 0 and standing.covered_at is not None and covered is None:
            forecasts.append((count, standing.covered_at))
        if stop is None and standing.is_enough:
            stop = count
        if stop is not None and covered is not None:
            break
    stop = stop or len(order)
    coverage = distances.coverage()
    return {
        "stop": stop,
        "covered": covered,
        "forecasts": forecasts,
        "unseen": coverage.unseen if coverage else None,
    }


def orders(design: str, number: int) -> Iterator[NDArray[np.int64]]:
    """Random orders; all presses of a piece one after the other."""
    each, rng = SIZES[design].each, np.random.default_rng([SHAPES, number])
    for _ in range(ORDERS):
        pieces = rng.permutation(SIZES[design].nominal // each)
        yield (pieces[:, None] * each + np.arange(each)).ravel()


def rows(parts: Sequence[int] = range(PARTS)) -> list[dict[str, Any]]:
    """A row per part, design and order."""
    found = []
    for number in parts:
        for design, sizes in SIZES.items():
            part = Part(make_pool(SHAPES, number, sizes))
            for count, order in enumerate(orders(design, number)):
                taken = acquisition(part.pool, order.tolist())
                row = {"design": design, "part": number, "order": count, **taken}
                found.append({**row, **part.fitted(np.sort(order[: taken["stop"]]))})
    return found


def test_acquisitions() -> None:
    """Prints the tables, and writes the rows that the page is compared with."""
    cv2.setNumThreads(1)
    found = rows()
    assert len(found) == PARTS * ORDERS * len(SIZES)
    write_rows(found)
    print("\n" + "\n\n".join("\n".join(lines) for lines in tables(found)))
