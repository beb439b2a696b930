"""Whether a bundle is proven on the mounted gel, and how many presses show it.

A bank is learnt on one gel. On another gel of the same sensor its scores differ, so the promise of its threshold holds
no more, until a bundle is made on the new gel or presses of sound parts have shown how often it alarms.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from edge.core.binomial import CONFIDENCE, trials_needed, upper_rate
from edge.core.printable import score_texts
from edge.core.sentence import Sentence
from edge.core.shadow import LEAST_ON_NEW_GEL

__all__ = ["PROVEN_RATE", "GelProof", "MadeOn", "Proven", "first_proof"]

PROVEN_RATE: Final = 0.1
"""Presses of sound parts show at most this rate of false alarms, with the confidence of every such promise. The goal of
`gelgate bundle acquire`: 22 presses without an alarm."""


class Proven(StrEnum):
    """Why a bundle is proven on a gel. The values are stored."""

    MADE = "made"
    FIRST_USE = "first use"
    PRESSES = "presses"


@dataclass(frozen=True)
class MadeOn:
    """What a bundle says of its own gel."""

    created: str
    """A date, as 2026-01-31."""
    gel_id: str | None = None
    """The gel; None where the bundle names none."""


@dataclass(frozen=True)
class GelProof:
    """One bundle on one gel. presses, alarms: of presses of sound parts, counted while it is not proven."""

    proven: Proven | None
    """Why it is, None where it is not."""
    known_from: str = ""
    """Where it comes from, in words."""
    presses: int = 0
    alarms: int = 0

    @property
    def rate(self) -> float:
        """The false alarms that the presses still allow, 0 to 1."""
        return upper_rate(self.alarms, self.presses) if self.presses else 1.0

    @property
    def still_needed(self) -> int:
        """Presses of sound parts without an alarm that are missing."""
        return max(0, trials_needed(PROVEN_RATE, self.alarms) - self.presses)

    @property
    def sentence(self) -> Sentence:
        """The presses on this gel and their alarms, in words."""
        if self.presses == 0:
            return Sentence("it has scored no press on this gel yet")
        rate, _ = score_texts(self.rate, PROVEN_RATE, 0, "%")
        return Sentence(
            f"on this gel {self.alarms} of {self.presses} presses alarmed, which allows {rate} of false alarms"
        )

    def unproven(self, bundle: str, gel_id: str) -> Sentence | None:
        """Say in one sentence, while it is not proven, what is missing and what to do.

        The sentence stays the same while presses alarm too often to prove anything.
        """
        if self.proven is not None:
            return None
        needed = self.still_needed
        shown = Sentence(f"{self.sentence}, at most {PROVEN_RATE:.0%} are wanted ({CONFIDENCE:.0%} sure)")
        if self.alarms > PROVEN_RATE * max(self.presses, trials_needed(PROVEN_RATE, 0)):
            shown = Sentence(
                f"more than {PROVEN_RATE:.0%} of its presses alarm there, and damaged parts count too: no proof"
            )
            todo = Sentence("Press sound parts alone until a number of them is asked for here")
        elif needed:
            todo = Sentence(f"Press {needed} more sound parts without an alarm, then `gelgate gel prove`")
        else:
            todo = Sentence("If all parts were sound, `gelgate gel prove`")
        return Sentence(
            f"bundle {bundle} is not yet proven on gel {gel_id}: {self.known_from}; {shown}. {todo}; or say what at "
            f"least {LEAST_ON_NEW_GEL} of its presses were, and learn from them (`gelgate bundle learn`), or fit a "
            "bundle on this gel"
        )


def first_proof(
    made: MadeOn,
    gel_id: str,
    mounted: str | None,
    used_on: str | None = None,
    was_in_use: bool = False,
    is_restored: bool = False,
) -> GelProof:
    """Begin the proof of a bundle that is used on this gel for the first time.

    mounted: the date of the gel; None for the first gel of a sensor, which may be older than the record of it. used_on:
    the gel on which the bundle was used last. was_in_use: it inspected here, or was a shadow, before this gel was
    mounted. is_restored: the database was lost, and with it what was used on which gel.

    A bundle that names its gel is taken at its word. Any other is taken as made on the gel on which it is used first,
    unless it was used, or made, before that gel was mounted, or may have been.
    """
    if made.gel_id is not None:
        is_same = made.gel_id == gel_id
        return (
            GelProof(Proven.MADE)
            if is_same
            else GelProof(None, Sentence(f"it was made on gel {made.gel_id}"))
        )
    if used_on is not None:
        return GelProof(None, Sentence(f"it was used on gel {used_on}"))
    if was_in_use:
        return GelProof(None, Sentence("it inspected here before this gel was mounted"))
    if is_restored:
        return GelProof(None, Sentence("the database was lost, so it is not known on which gel it was used"))
    if mounted is not None and made.created < mounted:
        return GelProof(
            None, Sentence(f"it was made on {made.created}, and the gel was mounted on {mounted}")
        )
    return GelProof(Proven.FIRST_USE)
