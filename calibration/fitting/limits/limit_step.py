"""The out-of-fold scores of a fit, and the choice of a limit from what they show."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.bundle_measurements import SCATTERED_MM, scatter_mm
from calibration.fitting.damage.edited_presses import edited_presses
from calibration.fitting.limits.folds import Folds
from calibration.fitting.limits.head_limit import can_extend
from calibration.fitting.limits.held_out import HeldOut, Learner, ScoredPresses, held_out
from calibration.fitting.limits.kinds import KINDS, PLAIN
from calibration.fitting.limits.limit_choice import Choice, Evidence, choose_limit
from calibration.fitting.limits.threshold import pieces_of
from calibration.fitting.presses.colours import nominal_colours, refuses
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.core.detector import Bank, Features, Nominal, Progress
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.press_again import KnownScores
from edge.model.press_again_facts import PRESS_AGAIN, score_facts

__all__ = ["LimitStep"]

Take = Callable[[NDArray[np.uint8]], Features]
"""The features of frames, uint8 (n, h, w, 3)."""

# Score maps of all presses are kept until a limit is chosen; of more than this only the scores are.
MEMORY_BYTES = 1 << 30


class LimitStep:
    """Scores the presses out of fold, with and without rendered damage, and chooses a limit from that.

    why_plain: why the plain limit is used without a choice; empty for a choice.
    """

    def __init__(
        self,
        learner: Learner,
        presses: NominalPresses,
        view: tuple[SensorProfile, Region],
        take: Take,
        folds: Folds,
        alpha: float,
        why_plain: str = "",
    ) -> None:
        self._learner, self._take = learner, take
        self._folds, self._alpha = folds, alpha
        self._specimens: Sequence[str | None] = presses.specimens or (None,) * len(presses)
        self._held_out: HeldOut | None = None
        self._is_black_refused = refuses(nominal_colours(presses.frames), np.zeros_like(presses.frames[0]))
        scatter = scatter_mm(presses, view[0])
        self._kinds = [kind for kind in KINDS if not kind.is_by_place or _is_placed(scatter)]
        self._why = why_plain or _too_large(presses)
        self._edited = (
            None if self._why else edited_presses(presses, *view, np.random.default_rng(learner.seed))
        )
        if self._edited is None:
            self._why = (
                self._why or "there is no picture of the free gel, or no contact, to render damage with"
            )
            self._damaged = None
        else:
            self._damaged = take(self._edited.frames), self._edited.press

    def scores(self, nominal: Nominal, progress: Progress) -> NDArray[np.float64]:
        """Of each press by a bank without it, (n,). Errors: FitError."""
        self._held_out = held_out(self._learner, nominal, self._folds, self._damaged, progress)
        return self._held_out.sound.scores

    def choice(self, bank: Bank, nominal: Nominal) -> Choice:
        """The limit for the final bank, after `scores`. Errors: FitError."""
        if self._edited is None or self._held_out is None:
            return Choice(PLAIN, self._why)
        if not can_extend(self._learner.head(bank)):
            return Choice(PLAIN, "another limit cannot be appended to the method's graph")
        rows = range(nominal.presses)
        return choose_limit(
            Evidence(
                self._held_out,
                self._learner.scored(bank, nominal.features, rows),
                self._black(bank),
                self._edited,
                self._folds,
                self._specimens,
                self._alpha,
                self._learner.grid.pixels_per_mm,
            ),
            self._kinds,
        )

    def found(self, choice: Choice, limit: float) -> tuple[int, int] | None:
        """How many of the presses with rendered damage are found, and their number; None where none was rendered.

        limit: the score that a press fails above, where the choice has not counted them.
        """
        if self._edited is None or self._held_out is None:
            return None
        above = float((self._held_out.edited.scores > limit).mean())
        share = choice.found[choice.kind.name] if choice.found else above
        return round(share * len(self._edited)), len(self._edited)

    def known_scores(self, scores: NDArray[np.float64], choice: Choice) -> dict[str, Any]:
        """What a station needs to know whether one more press pays, for the manifest's facts; empty without rendered
        damage. scores: of the nominal presses, in units of the bundle's score."""
        if self._edited is None or self._held_out is None:
            return {}
        damaged = choice.chosen.damaged if choice.chosen else self._held_out.edited.scores
        names = tuple(dict.fromkeys(self._edited.names))
        of = np.array([names.index(name) for name in self._edited.names])
        groups = tuple(tuple(damaged[of == k].tolist()) for k in range(len(names)))
        keys = pieces_of(self._specimens)
        sound = tuple(
            tuple(float(score) for score, key in zip(scores, keys, strict=True) if key == piece)
            for piece in dict.fromkeys(keys)
        )
        return {PRESS_AGAIN: score_facts(KnownScores(sound, groups), names)}

    def _black(self, bank: Bank) -> ScoredPresses | None:
        """A black frame, scored; None where the gateway refuses it for its colours."""
        black = np.zeros((1, *self._learner.grid.frame, 3), np.uint8)
        return None if self._is_black_refused else self._learner.scored(bank, self._take(black), [0])


def _is_placed(scatter_mm: float | None) -> bool:
    """Whether presses lie at one place: else the next one lies where none was, and no range is known there."""
    return scatter_mm is not None and scatter_mm <= SCATTERED_MM


def _too_large(presses: NominalPresses) -> str:
    if 4 * int(np.prod(presses.frames.shape[:3])) <= MEMORY_BYTES:
        return ""
    return f"the score maps of {len(presses)} presses take more memory than a choice may use"
