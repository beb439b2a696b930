"""Registration in a bundle: three pictures and some numbers of the manifest."""

from collections.abc import Callable

import numpy as np

from edge.core.errors import BundleCorrupt
from edge.core.registration.colours import SlopeColours
from edge.core.registration.registrar import PartInPose
from edge.model.archive import Archive
from edge.model.bundle_pictures import png_bytes, read_picture
from edge.model.manifest_files import FileEntry
from edge.model.manifest_registration import RegistrationEntry

__all__ = ["read_registration", "registration_entry"]

_FOLDER = "registration"


def registration_entry(part: PartInPose, keep: Callable[[str, bytes], FileEntry]) -> RegistrationEntry:
    """The manifest's entry. keep: stores a file by its name."""
    learnt = np.repeat(np.where(part.learnt, np.uint8(255), np.uint8(0))[..., None], 3, axis=2)
    red, green, blue = ((float(x), float(y)) for x, y in part.colours.matrix)
    return RegistrationEntry(
        free=keep(f"{_FOLDER}/free.png", png_bytes(part.free)),
        template=keep(f"{_FOLDER}/template.png", png_bytes(part.template)),
        learnt=keep(f"{_FOLDER}/learnt.png", png_bytes(learnt)),
        colours=(red, green, blue),
        is_turning=part.is_turning,
        least_match=part.least_match,
        least_seen=part.least_seen,
        scores_relief_to_end=part.scores_relief_to_end,
    )


def read_registration(
    archive: Archive, entry: RegistrationEntry | None, frame: tuple[int, int]
) -> PartInPose | None:
    """Read the part in its pose; None for a bundle without one. frame: (h, w) of the region. Errors: BundleCorrupt."""
    if entry is None:
        return None
    try:
        return PartInPose(
            free=read_picture(archive, entry.free, frame),
            template=read_picture(archive, entry.template, frame),
            learnt=read_picture(archive, entry.learnt, frame)[..., 0] > 127,
            colours=SlopeColours(np.array(entry.colours)),
            is_turning=entry.is_turning,
            least_match=entry.least_match,
            least_seen=entry.least_seen,
            scores_relief_to_end=entry.scores_relief_to_end,
        )
    except ValueError as error:
        raise BundleCorrupt(f"bundle {archive.where}: registration: {error}; fit again") from error
