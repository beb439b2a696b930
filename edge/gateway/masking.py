"""A press without the places that are not judged: as it is inspected, and as it is made again."""

from dataclasses import replace

import numpy as np

from edge.core.press import Press, ScarFindings
from edge.core.verdict import Kind
from edge.model.bundle import Bundle

__all__ = ["blinded", "masked"]


def masked(inspection: Press, findings: ScarFindings, bundle: Bundle) -> Press:
    """Judged without the masked places, which have the lowest score of the map.

    Errors: ValueError for an inspection without a score.
    """
    verdict, score_map = inspection.verdict, inspection.score_map
    if verdict is None or score_map is None:
        raise ValueError("a press without a score has no places to leave out")
    if findings.masked is not None:
        score_map = np.where(findings.masked, score_map.min(), score_map)
        verdict = bundle.manifest.decide(float(score_map.max()))
    return blinded(replace(inspection, verdict=verdict, score_map=score_map, scars=findings))


def blinded(inspection: Press) -> Press:
    """The same; unsure instead of passed where more than is accepted was not judged."""
    verdict, scars = inspection.verdict, inspection.scars
    if verdict is None or scars is None or not scars.is_too_blind or verdict.kind is not Kind.PASS:
        return inspection
    return replace(inspection, verdict=replace(verdict, kind=Kind.UNSURE))
