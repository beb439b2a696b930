"""From trials to a card and a table: a curve at each place and over all of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.experiments.detectability.pod import Pod, fit_pod
from calibration.experiments.detectability.study import Place, Plan, Row
from calibration.fitting.damage.damage import KINDS
from calibration.fitting.fit import Fitted
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import Bundle
from edge.model.bundle_writer import manifest_bytes
from edge.model.detectability import CARD, DetectabilityCard, KindCard
from edge.model.signature import SIGNATURE

__all__ = ["KindResult", "card", "results", "table", "write_card"]


@dataclass(frozen=True)
class KindResult:
    """One kind of damage: the curve over all places, and that of each place."""

    kind: str
    anywhere: Pod
    places: dict[Place, Pod]


def results(planned: Plan, rows: Sequence[Row]) -> list[KindResult]:
    """Fit the curves of each kind."""
    curves = []
    for kind in planned.settings.kinds:
        own = [row for row in rows if row["kind"] == kind]
        at = {place: [row for row in own if tuple(row["place"]) == place] for place in planned.places}
        curves.append(
            KindResult(kind, _pod(kind, own), {place: _pod(kind, some) for place, some in at.items()})
        )
    return curves


def _pod(kind: str, rows: Sequence[Row]) -> Pod:
    highs = [math.inf if row["high_mm"] is None else row["high_mm"] for row in rows]
    return fit_pod([row["low_mm"] for row in rows], highs, KINDS[kind].largest_mm)


def card(planned: Plan, found: Sequence[KindResult], created: str) -> DetectabilityCard:
    """Return what the bundle carries. created: a date."""
    middles = (planned.grid.middle_mm(place) for place in planned.places)
    return DetectabilityCard(
        created=created,
        presses=len(planned.presses),
        false_alarms=len(planned.false_alarms),
        judged_by=planned.by,
        spacing_mm=planned.settings.spacing_mm,
        places=tuple((round(x, 3), round(y, 3)) for x, y in middles),
        kinds=tuple(_kind_card(one) for one in found),
    )


def _kind_card(one: KindResult) -> KindCard:
    pods = list(one.places.values())
    return KindCard(
        kind=one.kind,
        largest_mm=KINDS[one.kind].largest_mm,
        trials=one.anywhere.trials,
        found=one.anywhere.found,
        a90_mm=_round_mm(one.anywhere.a90_mm),
        a90_95_mm=_round_mm(one.anywhere.a90_95_mm),
        place_a90_mm=tuple(_round_mm(pod.a90_mm) for pod in pods),
        place_a90_95_mm=tuple(_round_mm(pod.a90_95_mm) for pod in pods),
        place_state=tuple(pod.state for pod in pods),
    )


def _round_mm(size_mm: float | None) -> float | None:
    return None if size_mm is None else round(size_mm, 4)


def table(found: DetectabilityCard) -> str:
    """Write CSV: a line for each kind and place, first for all places together; sizes in mm, empty if not known."""
    lines = ["damage,x_mm,y_mm,a90_mm,a90_95_mm,state"]
    for kind in found.kinds:
        at = zip(found.places, kind.place_a90_mm, kind.place_a90_95_mm, kind.place_state, strict=True)
        cells = [("", "", kind.a90_mm, kind.a90_95_mm, ""), *((*place, *rest) for place, *rest in at)]
        lines += [",".join("" if cell is None else str(cell) for cell in (kind.kind, *row)) for row in cells]
    return "\n".join(lines)


def write_card(path: Path, card: DetectabilityCard) -> bool:
    """Put the card into a bundle, in place of an older one; at once or not at all.

    A signature no longer holds and is removed: True where there was one. Errors: BundleError, StoreError.
    """
    archive, old = open_archive(path), Bundle.load(path).manifest
    manifest = old.model_copy(update={"facts": {**old.facts, CARD: card.model_dump(mode="json")}})
    files = {entry.file: archive.read(entry.file) for entry in old.files}
    was_signed = archive.has(SIGNATURE)
    Fitted(manifest, {**files, MANIFEST: manifest_bytes(manifest)}).write(path, overwrite=True)
    return was_signed
