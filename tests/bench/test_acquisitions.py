"""1,000 simulated acquisitions on parts that no setting was chosen on: the tables of docs/acquire.md.

Run with `make acquisitions`, about half an hour on one quiet core. Twenty random parts; of each 40 nominal presses, of
40 pieces or of 10 pieces with 4 presses each, taken in 25 random orders; 100 presses of 100 other pieces for the true
rate of false alarms; and damaged presses. An acquisition takes presses until `gelgate bundle acquire` calls them
enough; then they are fitted as `gelgate fit` does. With ACQUISITIONS_CACHE naming a folder pictures and finished rows
are kept there, and a run that was cut goes on.

The settings (PAYS, ROUND, EARLIEST, MOST_CELLS, the rule of near) were chosen on parts of another seed, 99, and the
parts of this one were opened once, after everything was settled.
"""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from acquisition_pools import SIZES, Pool, pool
from acquisition_tables import tables, write_rows
from numpy.typing import NDArray

from calibration.acquisition.coverage import ROUND, PlaceDistances, Standing
from calibration.fitting.limits.covering import covering_bank
from calibration.fitting.limits.folds import divide_presses
from calibration.fitting.limits.held_out import Learner, score_held_out
from calibration.fitting.limits.threshold import conformal_threshold
from calibration.metrics import aupro
from edge import registry
from edge.core.detector import Bank, Features, Grid, Nominal
from edge.model.packing import pack, unpack
from edge.model.session import open_session

pytestmark = pytest.mark.bench

SHAPES, PARTS, ORDERS = 8128, 20, 25
METHOD, ALPHA, FOLDS = "padim", 0.05, 5
# Sound presses beside the damaged ones for AU-PRO.
SOUND = 20


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

    covered: the presses after which more did not pay; it may come before the end, and is None if it never came.
    """
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
    """A row per part, design and order; those in the cache are not measured again."""
    folder = os.environ.get("ACQUISITIONS_CACHE")
    cache = Path(folder) if folder else None
    file = cache / "acquisitions.jsonl" if cache else None
    found = [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []
    known = {(row["design"], row["part"], row["order"]) for row in found}
    for number in parts:
        for design, sizes in SIZES.items():
            part = None
            for count, order in enumerate(orders(design, number)):
                if (design, number, count) in known:
                    continue
                part = part or Part(pool(SHAPES, number, sizes, cache))
                taken = acquisition(part.pool, order.tolist())
                row = {"design": design, "part": number, "order": count, **taken}
                found.append({**row, **part.fitted(np.sort(order[: taken["stop"]]))})
                if file:
                    with file.open("a") as out:
                        out.write(json.dumps(found[-1]) + "\n")
    return found


def test_acquisitions() -> None:
    """Prints the tables, and writes the rows that the page is compared with."""
    cv2.setNumThreads(1)
    found = rows()
    assert len(found) == PARTS * ORDERS * len(SIZES)
    write_rows(found)
    print("\n" + "\n\n".join("\n".join(lines) for lines in tables(found)))
