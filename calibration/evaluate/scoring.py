"""Scoring a bundle on a dataset. Presses that the bundle was fitted on are left out; their specimens are counted."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.dataset import Dataset, LabelledPress, open_dataset, resolution_of
from calibration.dataset.press import empty_masks, repeated_pictures
from calibration.metrics.summary import Measure, measure
from calibration.progress import Show
from calibration.threads import one_blas_thread
from edge.core.arrays import F32, Mask
from edge.core.errors import DatasetError, NotScorable
from edge.core.registration.pose import Pose
from edge.core.verdict import Kind
from edge.model.bundle import Bundle
from edge.model.manifest import Manifest
from edge.model.scorer import Scorer

__all__ = ["Evaluation", "evaluate_bundle"]

EVERY = "*"
"""The name for every part or position of a dataset."""


@dataclass(frozen=True)
class ScoredPress:
    """One press with its map, float32 (h, w) of the region, and its mask in the same pixels."""

    press: LabelledPress
    score_map: F32
    mask: Mask
    anomaly_score: float
    trunk_ms: float
    head_ms: float
    pose: Pose | None = None
    """How the part lies; None for a bundle without registration."""


@dataclass(frozen=True)
class Evaluation:
    """All results of an evaluation."""

    bundle: Bundle
    dataset: Dataset
    scored: tuple[ScoredPress, ...]
    measures: tuple[Measure, ...]
    left_out: int
    """Presses of the dataset that the bundle was fitted on."""
    seen_specimens: int
    """Scored specimens with other presses in the fit."""
    unscorable: tuple[tuple[LabelledPress, str], ...]
    """Presses without a score, with the reason."""
    limit: float
    replicates: int
    seed: int

    @property
    def threshold(self) -> float:
        return self.bundle.manifest.threshold.value

    @property
    def false_alarms(self) -> int:
        """Good presses that the gateway would fail."""
        return self._count(Kind.FAIL, is_defective=False)

    @property
    def misses(self) -> int:
        """Defective presses that the gateway would pass."""
        return self._count(Kind.PASS, is_defective=True)

    @property
    def unsure(self) -> tuple[int, int]:
        """Good and defective presses that are too near the threshold for a verdict."""
        return self._count(Kind.UNSURE, is_defective=False), self._count(Kind.UNSURE, is_defective=True)

    @property
    def remarks(self) -> list[str]:
        """Sentences on what may be a mistake of the dataset: empty masks, and copies of pictures."""
        where, presses = self.dataset.root.name, [scored_press.press for scored_press in self.scored]
        defective = [scored_press for scored_press in self.scored if scored_press.press.is_defective]
        digests = [hashlib.sha256(press.path.read_bytes()).digest() for press in presses]
        return [
            *empty_masks(
                where,
                [scored_press.press for scored_press in defective],
                [scored_press.mask for scored_press in defective],
            ),
            *repeated_pictures(where, presses, digests),
        ]

    def _count(self, kind: Kind, *, is_defective: bool) -> int:
        """Count how many presses of this truth get this verdict."""
        decided = self.bundle.manifest.decide
        asked = (s for s in self.scored if s.press.is_defective is is_defective)
        return sum(decided(s.anomaly_score).kind is kind for s in asked)


@one_blas_thread()
def evaluate_bundle(
    bundle_path: Path,
    dataset_path: Path,
    *,
    part: str | None,
    position: str | None,
    limit: float,
    replicates: int,
    seed: int,
    show: Show,
) -> Evaluation:
    """Load, score and measure. part, position: None is the bundle's own, "*" is every one.

    Errors: BundleError, DatasetError (the dataset lacks the part or position; nothing is left to score).
    """
    bundle = Bundle.load(bundle_path)
    whole = open_dataset(dataset_path, resolution_of(bundle.profile.size))
    dataset = _choose_presses(whole, bundle, part, position)
    fitted = _find_fitted(whole.presses, bundle.manifest)
    presses = tuple(p for p in dataset.presses if p.path not in fitted)
    if not presses:
        raise DatasetError(
            f"the bundle '{bundle_path}' was fitted on all {len(dataset.presses)} presses of '{dataset_path}'; "
            "evaluate on presses that were held out"
        )
    known = {p.specimen for p in dataset.presses if p.path in fitted and p.specimen}
    scored, unscorable = score_presses(Scorer(bundle), presses, show)
    if not scored:
        raise DatasetError(f"no press of '{dataset_path}' has a score; the first: {unscorable[0][1]}")
    return Evaluation(
        bundle=bundle,
        dataset=dataset,
        scored=scored,
        measures=_measures(scored, limit, replicates, seed),
        left_out=len(dataset.presses) - len(presses),
        seen_specimens=len(known & {p.specimen for p in presses}),
        unscorable=unscorable,
        limit=limit,
        replicates=replicates,
        seed=seed,
    )


def _choose_presses(dataset: Dataset, bundle: Bundle, part: str | None, position: str | None) -> Dataset:
    """The presses of the given part and position. Errors: DatasetError if the dataset has none of them."""
    own = bundle.manifest.part, bundle.manifest.position
    wanted = [mine if asked is None else asked for asked, mine in zip((part, position), own, strict=True)]
    pair = [None if name == EVERY else name for name in wanted]
    try:
        return dataset.select(*pair)
    except DatasetError as error:
        raise DatasetError(
            f"{error}; the bundle is of {'/'.join(own)}: choose with --part and --position, '{EVERY}' for all"
        ) from None


def _find_fitted(presses: Sequence[LabelledPress], manifest: Manifest) -> set[Path]:
    """Find the files named in the provenance: a name is the end of a path, such as `rgb_320x240/PZ3_pos1_s001_p01.png`.

    presses: the whole dataset. MVTec folders have the same file names in train/good and test/good: of presses of one
    name those of the bundle's part and position are meant, else those in train.
    """
    ending: dict[str, list[LabelledPress]] = {}
    for press in presses:
        parts = press.path.parts
        for k in range(1, len(parts)):
            ending.setdefault("/".join(parts[-k:]), []).append(press)

    def likeness(press: LabelledPress) -> tuple[bool, bool, bool]:
        at = press.position
        return press.part == manifest.part, at == manifest.position, at == "train"

    paths: set[Path] = set()
    for name in manifest.provenance.presses:
        meant = ending.get(name.lstrip("/"), [])
        most = max(map(likeness, meant), default=None)
        paths |= {press.path for press in meant if likeness(press) == most}
    return paths


def score_presses(
    scorer: Scorer, presses: tuple[LabelledPress, ...], show: Show
) -> tuple[tuple[ScoredPress, ...], tuple[tuple[LabelledPress, str], ...]]:
    """Score each press in the bundle's region. Errors: DatasetError when a picture does not fit the profile."""
    region, size = scorer.bundle.region, scorer.bundle.profile.size
    wrong = [p for p in presses if p.size != size]
    if wrong:
        raise DatasetError(
            f"{len(wrong)} pictures are not {size[0]}x{size[1]} as in the bundle's profile "
            f"'{scorer.bundle.profile.name}', such as '{wrong[0].path}' at {wrong[0].size[0]}x{wrong[0].size[1]}"
        )
    scored: list[ScoredPress] = []
    unscorable: list[tuple[LabelledPress, str]] = []
    with show("scoring presses", len(presses)) as advance:
        for done, press in enumerate(presses, start=1):
            try:
                press_score = scorer.score(np.ascontiguousarray(region.crop(press.rgb())))
            except NotScorable as error:
                unscorable.append((press, str(error)))
            else:
                mask = np.ascontiguousarray(region.crop(press.mask()))
                pose = None if press_score.registered is None else press_score.registered.pose
                fields = (
                    press_score.score_map,
                    mask,
                    press_score.anomaly_score,
                    press_score.trunk_ms,
                    press_score.head_ms,
                    pose,
                )
                scored.append(ScoredPress(press, *fields))
            advance(done)
    return tuple(scored), tuple(unscorable)


def _measures(
    scored: tuple[ScoredPress, ...], limit: float, replicates: int, seed: int
) -> tuple[Measure, ...]:
    specimens = [s.press.specimen for s in scored]
    return measure(
        [s.score_map for s in scored],
        [s.mask for s in scored],
        np.array([s.anomaly_score for s in scored]),
        [str(s) for s in specimens] if all(specimens) else None,
        is_defective=np.array([s.press.is_defective for s in scored], np.bool_),
        limit=limit,
        replicates=replicates,
        seed=seed,
    )
