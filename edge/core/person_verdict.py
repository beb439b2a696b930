"""What a person says of a press, beside the machine's verdict: what it shows, and which presses to ask about."""

import hashlib
import math
from collections import Counter
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from edge.core.binomial import rate_limits
from edge.core.printable import write_count
from edge.core.sentence import Sentence, join_sentences

__all__ = [
    "Agreement",
    "Asked",
    "PersonVerdict",
    "Saying",
    "choose_questions",
    "describe_escapes",
    "find_broken_promise",
    "is_called_damaged",
    "settle",
]

Saying = Literal["good", "damaged", "gel", "cannot_tell"]
"""The part is good; it is damaged; a mark of the gel shows, and the part is good; a person cannot tell."""

# Presses that an alarm names.
_MOST_NAMED: Final = 20


@dataclass(frozen=True)
class PersonVerdict:
    """What one person said of one press."""

    press_id: str
    time_ns: int
    """Wall clock."""
    person: str
    """The name that was given, or by which way it came."""
    saying: str
    kind: str | None = None
    """What the damage is, such as `burr`."""


def settle(verdicts: Sequence[PersonVerdict]) -> PersonVerdict | None:
    """Return what holds of one press: the newest word of each person, oldest first in `verdicts`; where persons
    contradict each other nobody can tell, unless twice as many say the same. None for a press of which nobody spoke.

    Names that differ in capitals and blanks alone are one person's.
    """
    newest = {_find_key(verdict): verdict for verdict in verdicts}
    if not newest:
        return None
    last = verdicts[-1]
    counts = Counter(verdict.saying for verdict in newest.values() if verdict.saying != "cannot_tell")
    most = max(counts.values(), default=0)
    counts = Counter({saying: count for saying, count in counts.items() if 2 * count > most})
    if len(counts) > 1:
        names = ", ".join(sorted(verdict.person for verdict in newest.values()))
        return PersonVerdict(last.press_id, last.time_ns, names, "cannot_tell")
    held = (
        verdict
        for verdict in reversed(verdicts)
        if verdict.saying in counts and newest[_find_key(verdict)] is verdict
    )
    return next(held, last)


def is_called_damaged(verdicts: Sequence[PersonVerdict]) -> bool:
    """Tell whether somebody calls a press damaged, and not twice as many something else. verdicts: oldest first."""
    held, newest = settle(verdicts), {_find_key(verdict): verdict.saying for verdict in verdicts}
    return held is not None and held.saying in ("damaged", "cannot_tell") and "damaged" in newest.values()


def _find_key(verdict: PersonVerdict) -> str:
    return " ".join(verdict.person.split()).casefold()


@dataclass
class Agreement:
    """How the verdicts of the machine agree with those of people, over some presses."""

    presses: int = 0
    passed: int = 0
    judged: int = 0
    """With a pass, a fail or unsure."""
    good: dict[bool, int] = field(default_factory=lambda: {True: 0, False: 0})
    """Presses whose part a person found good, by whether they passed."""
    damaged: dict[bool, int] = field(default_factory=lambda: {True: 0, False: 0})
    """The same, damaged."""

    def add(self, verdict: str, saying: str | None) -> None:
        """Count a press. verdict: the machine's. saying: what settled; None where nobody spoke."""
        is_pass = verdict == "pass"
        self.presses += 1
        self.passed += is_pass
        if verdict not in ("pass", "fail", "unsure"):
            return
        self.judged += 1
        if saying in ("good", "gel"):
            self.good[is_pass] += 1
        elif saying == "damaged":
            self.damaged[is_pass] += 1

    def describe(self) -> str:
        """Give yield, false alarms and escapes in one line, with what is not known.

        Intervals are those of Clopper and Pearson, 90 % sure at each end. They are of the presses that people looked
        at: who looks at doubtful ones finds more.
        """
        share = f"{self.passed / self.presses:.1%}" if self.presses else "-"
        return (
            f"{write_count(self.presses, 'press')}, yield {share}; "
            f"false alarms: {_rate(self.good[False], self.good[False] + self.damaged[False], 'fail')}; "
            f"escapes: {_rate(self.damaged[True], self.good[True] + self.damaged[True], 'pass')}"
        )


def _rate(wrong: int, said: int, word: str) -> str:
    if not said:
        return f"not known, nobody judged a {word}"
    low, high = rate_limits(wrong, said)
    return f"{wrong} of {write_count(said, f'judged {word}')} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True)
class Asked:
    """A press that a person may be asked about."""

    press_id: str
    time_ns: int
    verdict: str
    score_ratio: float | None
    """Score by threshold; None where its colours were refused, as those of another gel."""
    part: str
    position: str | None = None

    @property
    def doubt(self) -> float:
        """Say how little is known of it, the larger the less: how close the score is to the threshold."""
        ratio = self.score_ratio or 0.0
        return -abs(math.log(ratio)) if 0 < ratio < math.inf else -math.inf


def choose_questions(
    presses: Iterable[Asked],
    answered: Container[str],
    most: int,
    new_gel_ns: int | None = None,
    answered_today: Collection[str] = (),
) -> list[Asked]:
    """Choose the presses that would teach most: closest to the threshold, and of five one pass and one other, drawn.

    Without the pass nobody would ever look at a damage that the machine does not see at all, without the other at sound
    parts that all fail by far. They are drawn by their times, so the choice stays the same until something changes.
    answered_today: those of `answered` that count as asked today; what is drawn for a day does not change with each
    answer. new_gel_ns: since then another gel is mounted, on which the bundle is not proven. Then its presses alone are
    asked for, drawn whatever their score: those close to a threshold of another gel would be the lowest, and its
    colours may be refused. Oldest first.
    """
    of_day = [one for one in presses if one.press_id not in answered or one.press_id in answered_today]
    share = (most + len(answered_today)) // 5
    if new_gel_ns is None:
        of_day = sorted((one for one in of_day if one.score_ratio is not None), key=_draw)
        passes = [one for one in of_day if one.verdict == "pass"]
        others = [one for one in of_day if one.verdict != "pass"]
        drawn = [*passes[:share], *others[:share]]
    else:
        of_day = drawn = sorted((one for one in of_day if one.time_ns >= new_gel_ns), key=_draw)
    drawn = [one for one in drawn if one.press_id not in answered][:most]
    close = sorted(
        (one for one in of_day if one.press_id not in answered and one not in drawn),
        key=lambda one: (-one.doubt, one.press_id),
    )
    return sorted([*drawn, *close[: most - len(drawn)]], key=lambda one: one.press_id)


def _draw(one: Asked) -> bytes:
    """Draw a press's place in a random order that is the same at each look."""
    return hashlib.sha256(b"%d" % one.time_ns).digest()


def describe_escapes(passed: Sequence[str], passing: Sequence[str]) -> Sentence | None:
    """Say which presses that people call damaged passed, and which others pass the bundle that inspects now, by their
    ids, the newest last; None for none."""
    number, sentences = len(passed), list[Sentence]()
    newest, others = (", ".join(reversed(ids[-_MOST_NAMED:])) for ids in (passed, passing))
    if passed:
        sentences.append(
            Sentence(
                f"presses that passed and that people called damaged in the last day: {number}, the newest {newest}"
            )
        )
    if passing:
        sentences.append(
            Sentence(
                "the bundle that inspects now passes presses that another one found and that people called damaged in "
                f"the last day: {others}"
            )
        )
    return join_sentences(sentences)


def find_broken_promise(
    presses: Sequence[Asked], said: Mapping[str, Sequence[PersonVerdict]], promised: float
) -> Sentence | None:
    """Say that more sound presses fail than `promised`, a rate; None where what people said does not show it.

    Nobody looks at all that fails. So the rate of fails, and the share of good ones among those that people looked at,
    are each taken as low as they may be.
    """
    failed = [press.press_id for press in presses if press.verdict != "pass"]
    settled = [settle(said.get(press_id, ())) for press_id in failed]
    words = [one.saying for one in settled if one is not None and one.saying != "cannot_tell"]
    good = words.count("good")
    if not good:
        return None
    if rate_limits(len(failed), len(presses))[0] * rate_limits(good, len(words))[0] <= promised:
        return None
    return Sentence(
        f"more sound parts fail than the bundle promises ({promised:.0%}): people call {good} of {len(words)} presses "
        "of the last day good that did not pass; learn from them (`gelgate bundle learn`)"
    )
