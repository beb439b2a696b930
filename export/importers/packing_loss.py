"""A bundle of an imported model, with what its smaller bank costs on nominal presses."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.fitting.bundle_measurements import count_stored
from calibration.fitting.features import extract
from calibration.fitting.fit import Fitted
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.progress import Report
from edge.core.arrays import F64, U8
from edge.core.detector import Bank
from edge.core.errors import BundleCorrupt
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files, facts_of
from edge.model.scorer import Scorer
from edge.model.session import open_session
from export.finish import Parts, WrapConfig, finish_bundle
from export.importers.contract import Imported
from export.parity import compare, rank_correlation, score_frames, score_stages
from export.weights_file import file_sha256

__all__ = ["Losses", "import_files"]

# Presses on which the full form of the model is compared with the stored one.
COMPARED_PRESSES = 8
# What packing may change: maps and scores, of the largest; the order of the presses is not checked where all are alike.
PACKED_MOST = 0.05


@dataclass(frozen=True)
class Losses:
    """What making the bank smaller costs, on the caller's presses, relative to the largest value."""

    reduction: float | None
    """Of raw distances, thin form against the file's own; None where nothing was reduced."""
    packing: float
    """Of scores; packing_map of maps, and order: the rank correlation of the scores of packed and unpacked bank."""
    packing_map: float
    order: float
    bytes_stored: int
    bytes_unpacked: int

    def words(self) -> str:
        """Say it in a sentence."""
        first = (
            ""
            if self.reduction is None
            else f"the reduction changes distances by at most {self.reduction:.2g} of the largest; "
        )
        return (
            f"{first}packing changes scores by at most {self.packing:.2g} and maps by {self.packing_map:.2g} of the "
            f"largest (rank correlation {self.order:.4f}); "
            f"the bank has {self.bytes_stored / 1e6:.2f} MB stored, {self.bytes_unpacked / 1e6:.2f} MB in use"
        )


def import_files(
    model: Imported,
    presses: NominalPresses,
    config: WrapConfig,
    source: Path,
    *,
    created: str,
    report: Report = lambda stage, fraction: None,
) -> tuple[Fitted, Losses]:
    """Make the bundle of an imported model, and measure what its smaller bank costs on these presses.

    presses, errors: as `finish_bundle`; BundleCorrupt where the packed bank does not score as the full one.
    """
    trunk = model.trunk
    graphs = Graphs(trunk=trunk.graph, head=model.head)
    parts = Parts(graphs, model.bank, trunk.id, model.grid, model.parameters, presses.free_view)
    origin = {"source": model.source, "file": source.name, **model.facts, "says": list(model.says)}
    facts = {"backbone": dict(trunk.facts), **config.facts, "imported": origin, "warnings": []}
    measured: list[Losses] = []

    def measure(scorer: Scorer, scores: F64) -> tuple[list[str], Mapping[str, Any]]:
        losses = _measure_losses(model, presses.frames[:COMPARED_PRESSES], scorer, config.threads, source)
        measured.append(losses)
        sha256 = file_sha256(source)
        return [], {"imported": {**origin, "losses": losses.words(), "file_sha256": sha256}}

    config = replace(config, facts=facts)
    fitted = finish_bundle(parts, presses, config, measure, created=created, report=report)
    return fitted, measured[0]


def _measure_losses(model: Imported, frames: U8, scorer: Scorer, threads: int, source: Path) -> Losses:
    """Measure what the smaller bank costs. Errors: BundleCorrupt where packing changes maps or scores too much."""
    arrays, packing = model.bank.arrays, model.bank.packing
    stored = count_stored(model.bank)
    used = sum(array.nbytes for array in arrays.values())
    reduction = _measure_reduction(model, frames, threads, source)
    if not packing:
        return Losses(reduction, 0.0, 0.0, 1.0, stored, used)
    facts, graphs = facts_of(scorer.bundle.manifest), scorer.bundle.graphs
    files = bundle_files(facts, graphs, Bank(arrays), backbone=model.trunk.id)
    full = score_frames(Scorer(Bundle.in_memory(*files), threads), frames)
    packed = score_frames(scorer, frames)
    report = compare(score_stages(full, packed, PACKED_MOST))
    if report.first_different is not None:
        raise BundleCorrupt(
            f"the packed bank of {source} differs from the full one: {report.first_different.sentence()}; "
            "store it with --packing none, or float16 in place of int8; nothing is imported"
        )
    of_map, of_score = (result.difference for result in report.results)
    order = rank_correlation(full[1], packed[1])
    return Losses(reduction, of_score, of_map, order, stored, used)


def _measure_reduction(model: Imported, frames: U8, threads: int, source: Path) -> float | None:
    if model.exact is None:
        return None
    session = open_session(model.trunk.graph, threads, f"the trunk of {source}")
    full, thin = model.exact(extract(session, frames, model.grid, lambda fraction: None))
    return float(np.abs(full - thin).max() / max(float(full.max()), 1e-12))
