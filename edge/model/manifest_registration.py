"""The manifest's entry on registration: how a press is brought to the pose in which the bank was learnt."""

from pydantic import Field

from edge.model.manifest_files import Entry, FileEntry

__all__ = ["RegistrationEntry"]

Levels = tuple[float, float]


class RegistrationEntry(Entry):
    """`PartInPose`: free, template and learnt are pictures of the region, learnt white where the bank is learnt.

    colours: for red, green and blue the levels of the two slopes. is_turning: false where the part has no turn, as a
    ball. least_match, least_seen: a press below either is rejected. scores_relief_to_end: false in bundles that do not
    state it; they were fitted with a seam around what a press shows that is not scored.
    """

    free: FileEntry
    template: FileEntry
    learnt: FileEntry
    colours: tuple[Levels, Levels, Levels]
    is_turning: bool
    least_match: float = Field(gt=0, lt=1)
    least_seen: float = Field(ge=0, le=1)
    scores_relief_to_end: bool = False

    @property
    def files(self) -> tuple[FileEntry, ...]:
        return self.free, self.template, self.learnt
