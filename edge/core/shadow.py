"""A shadow: a bundle that scores presses beside the one in use and decides nothing; whether it may take over."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from edge.core.binomial import rate_limits
from edge.core.printable import write_count
from edge.core.sentence import Sentence

__all__ = [
    "LEAST_COMPARED",
    "LEAST_ON_NEW_GEL",
    "JudgedTwice",
    "Weighing",
    "describe_new_gel",
    "describe_way",
    "is_more",
]

LEAST_COMPARED: Final = 100
"""Presses that both bundles have judged before one may take the other's place. Where none of 100 sound presses
fails, at most 3 % of all do, 95 % sure (Hanley and Lippman-Hand 1983)."""

LEAST_ON_NEW_GEL: Final = 4
"""Presses of a new gel that people call good: so many must be learnt, and be judged by both, before a shadow may take
the place of a bundle that is not proven on this gel. Nothing is promised of the latter there, so nothing is lost by the
shadow but damage, which is compared. Fewer say nothing of a gel: 4 are the fewest that a threshold is found by."""

_MOST_BY_CHANCE: Final = 0.05
"""A shadow need not wait where the good presses on which the two differ favour it as much as this seldom by chance
(sign test, McNemar 1947): five of five, or eight of nine. By itself it does not take over where the presses on which
they differ, but damage, speak as much against it."""

_JUDGED: Final = ("pass", "fail", "unsure")

# Presses that are named in a sentence of many.
_MOST_NAMED: Final = 8


@dataclass(frozen=True)
class JudgedTwice:
    """A press that two bundles have judged."""

    press_id: str
    verdict: str
    """Of the bundle in use."""
    other: str
    """Of the shadow."""
    saying: str | None
    """What people say of it; None where nobody spoke."""
    was_damaged: bool
    """Whether anybody ever called it damaged, whatever was said later."""

    @property
    def is_lost(self) -> bool:
        """Say whether it is a damage that was found and would pass."""
        return self.saying == "damaged" and self.verdict != "pass" and self.other == "pass"


@dataclass(frozen=True)
class Weighing:
    """Two bundles, by the presses that both have judged."""

    presses: Sequence[JudgedTwice]
    unknown: Sequence[str] = ()
    """A sentence for each known damage of which it is not known whether the shadow finds it."""
    is_new_gel: bool = False
    """Whether the bundle in use is not proven on the mounted gel, and the shadow has learnt presses of it."""
    is_by_itself: bool = False
    """Whether nobody asks for the takeover, and so nobody answers for what the shadow alone passes."""

    @property
    def differing(self) -> list[JudgedTwice]:
        """The presses that one of them passes and the other does not."""
        return [press for press in self.presses if (press.verdict == "pass") != (press.other == "pass")]

    def describe(self) -> str:
        """Give false alarms and misses of both in one sentence."""
        damaged = [press for press in self.presses if press.saying == "damaged"]
        good = self._good
        stricter = sum(verdict.verdict == "pass" for verdict in self.differing)
        return (
            f"{write_count(len(self.presses), 'press')} judged by both: {stricter} pass the bundle in use alone, "
            f"{len(self.differing) - stricter} the shadow alone; of {len(good)} that people call good "
            f"{_count(good, 'verdict', passes=False)} and {_count(good, 'other', passes=False)} do not pass, of "
            f"{len(damaged)} that they call damaged {_count(damaged, 'verdict', passes=True)} and "
            f"{_count(damaged, 'other', passes=True)} pass"
        )

    def doubts(self) -> list[str]:
        """Name the presses that anybody ever called damaged and the shadow passes, and say which are unknown."""
        passing = [press.press_id for press in self.presses if press.was_damaged and press.other == "pass"]
        named = [f"it passes {', '.join(passing)}, which somebody called damaged"] if passing else []
        return [*named, *self.unknown]

    @property
    def lost(self) -> list[str]:
        """Damage that was found and that the shadow passes."""
        return [press.press_id for press in self.presses if press.is_lost]

    @property
    def unexplained(self) -> list[str]:
        """Presses that the shadow alone passes, and of which nobody said anything."""
        return [
            verdict.press_id
            for verdict in self.differing
            if verdict.other == "pass" and verdict.saying is None
        ]

    @property
    def new_alarms(self) -> list[str]:
        """Good presses that pass the bundle in use and not the shadow, where more do not pass the shadow."""
        now, then = _count(self._good, "other", passes=False), _count(self._good, "verdict", passes=False)
        failing = [one.press_id for one in self._good if one.other != "pass" and one.verdict == "pass"]
        return failing if now > then else []

    @property
    def _good(self) -> list[JudgedTwice]:
        return [press for press in self.presses if press.saying in ("good", "gel")]

    @property
    def is_clear(self) -> bool:
        """Whether good presses that the bundle in use alone fails show that the shadow is better. Every press that the
        shadow alone does not pass speaks against it, unless people call it damaged. Nothing is clear where it passes a
        press that the other one found and anybody ever called damaged, or where that is not known."""
        better = sum(
            press.saying == "good" and press.verdict in ("fail", "unsure") and press.other == "pass"
            for press in self.presses
        )
        worse = sum(
            press.saying != "damaged" and press.verdict == "pass" and press.other != "pass"
            for press in self.presses
        )
        is_lost = any(
            press.was_damaged and press.verdict != "pass" and press.other == "pass" for press in self.presses
        )
        return is_more(better, worse) and not is_lost and not self.unknown

    def refusals(self, *, has_promise: bool) -> list[str]:
        """Say why the shadow may not take over; nothing where it may."""
        sentences: list[str] = []
        if not has_promise:
            sentences.append(
                "it promises no rate of false alarms: fit it from presses, without a given threshold"
            )
        both = sum(press.verdict in _JUDGED and press.other in _JUDGED for press in self.presses)
        compared, least, which = both, LEAST_COMPARED, ""
        if self.is_new_gel:
            compared, least, which = len(self._good), LEAST_ON_NEW_GEL, " that people call good"
        if compared < least and not self.is_clear:
            sentences.append(
                f"both have judged {write_count(compared, 'press')}{which}, at least {least} are needed"
            )
        if self.lost:
            sentences.append(f"it passes damage that was found: {', '.join(self.lost)}")
        if self.is_by_itself:
            sentences += self._find_unanswered()
        if self.new_alarms:
            good = self._good
            now, then = _count(good, "other", passes=False), _count(good, "verdict", passes=False)
            sentences.append(
                f"{now} instead of {then} of the {write_count(len(good), 'press')} that people call good do not "
                f"pass it: {', '.join(self.new_alarms[:_MOST_NAMED])}"
            )
        return sentences

    def _find_unanswered(self) -> list[str]:
        """Say for what somebody has to answer who asks for the takeover; nothing where that is nothing."""
        sentences: list[str] = []
        if self.unexplained and not self.is_new_gel:
            named = ", ".join(self.unexplained[:_MOST_NAMED])
            sentences.append(f"it alone passes {named}, and nobody has said what they were")
        if self.unknown:
            sentences.append(
                f"whether it finds the damage of {write_count(len(self.unknown), 'press')} is not known"
            )
        sound = [verdict for verdict in self.differing if not verdict.was_damaged]
        failing = [one.press_id for one in sound if one.other != "pass"]
        passing = len(sound) - len(failing)
        if is_more(len(failing), passing):
            sentences.append(
                f"{write_count(len(failing), 'press')} that nobody called damaged pass the bundle in use alone, "
                f"{passing} the shadow alone, more than by chance: {', '.join(failing[:_MOST_NAMED])}"
            )
        return sentences


def is_more(more: int, fewer: int) -> bool:
    """Tell whether equal bundles would differ this much, more presses for one than for the other, seldom by chance."""
    return rate_limits(more, more + fewer, 1 - _MOST_BY_CHANCE)[0] > 0.5


def describe_way(failed: int, *, has_shadow: bool) -> Sentence:
    """Say what is missing until what people call good passes. failed: such presses that the bundle in use failed."""
    enough = next(number for number in range(1, LEAST_COMPARED) if is_more(number, 0))
    missing = max(0, enough - failed)
    if not has_shadow:
        return Sentence(
            f"nothing changes by a word alone: learn from it (`gelgate bundle learn`) and name the new bundle as the "
            f"shadow; more presses that this bundle fails and people call good until it may take over: {missing}, or "
            f"it waits until both have judged {LEAST_COMPARED}"
        )
    return Sentence(
        f"the shadow takes over on request (`adopt_shadow`); more presses that this bundle fails, the shadow passes "
        f"and people call good until it may: {missing}, or it waits until both have judged {LEAST_COMPARED}"
    )


def describe_new_gel(good: int) -> Sentence:
    """Say how many presses of a gel, on which the bundle is not proven, people must call good until it is learnt."""
    missing = max(0, LEAST_ON_NEW_GEL - good)
    return Sentence(
        f"the bundle is not proven on this gel; more of its presses that people call good until it can be learnt "
        f"(`gelgate bundle learn`): {missing}"
    )


def _count(presses: Collection[JudgedTwice], whose: str, *, passes: bool) -> int:
    """Count those that pass, or do not, by `verdict` or `other`."""
    return sum((getattr(press, whose) == "pass") == passes for press in presses)
