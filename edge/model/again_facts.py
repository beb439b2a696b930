"""What a bundle knows of second presses: the scores of its fit, an entry of the manifest's `facts`, and the plan that
follows from them."""

from collections.abc import Mapping
from typing import Any, Final

from pydantic import Field, ValidationError

from edge.core.press_again import Costs, KnownScores, Plan, plan
from edge.core.printable import write_most
from edge.model.manifest import Manifest
from edge.model.manifest_files import Entry

__all__ = ["DEFAULT_COSTS", "PRESS_AGAIN", "again_sentence", "plan_for", "score_facts"]

PRESS_AGAIN: Final = "press_again"
"""The entry's name among the manifest's facts."""

DEFAULT_COSTS: Final = Costs(missed=1000, false_alarm=100, press=1, defect_rate=0.01)
"""In presses: a damaged piece that passes costs a thousand of them, a sound piece that fails a hundred."""


class _Scores(Entry):
    """sound: scores of nominal presses by banks without them, piece by piece. damaged: kind and size of rendered damage
    to the scores of presses with it. All in units of the bundle's score."""

    sound: tuple[tuple[float, ...], ...] = Field(min_length=1)
    damaged: dict[str, tuple[float, ...]]


def score_facts(known: KnownScores, names: tuple[str, ...]) -> dict[str, Any]:
    """Give the manifest's entry. names: the kinds of damage, in the order of the scores."""
    damaged = dict(zip(names, known.damaged, strict=True))
    return _Scores(sound=known.sound, damaged=damaged).model_dump(mode="json")


def plan_for(manifest: Manifest, costs: Costs) -> Plan:
    """Plan one more press with this bundle; without such scores the plan is `never`, no error."""
    scores = manifest.facts.get(PRESS_AGAIN)
    if not isinstance(scores, Mapping):
        return Plan("the bundle has no scores of damaged presses and of pieces pressed twice; fit it again")
    try:
        entry = _Scores.model_validate(scores)
    except ValidationError as error:
        return Plan(f"the bundle's scores cannot be read ({error.errors()[0]['msg']}); fit it again")
    limit = manifest.threshold
    if limit.alpha_floor == 1:
        given = "the threshold was given, so no rate of false alarms is promised"
        return Plan("no rate of false alarms is promised of new pieces" if limit.n else given)
    rate = max(limit.alpha, limit.alpha_floor)
    return plan(KnownScores(entry.sound, tuple(entry.damaged.values())), limit.value, rate, costs)


def again_sentence(plan: Plan) -> str:
    """Say for `inspect`, `check` and the log whether one more press pays."""
    if plan.bound is None:
        return f"never: {plan.why}"
    return (
        f"pays up to a score of {plan.bound:.4g}: {plan.presses:.3f} presses a piece, false alarms at most "
        f"{' -> '.join(map(write_most, plan.false_alarms))}, rendered damage missed "
        f"{' -> '.join(f'{100 * share:.3g} %' for share in plan.misses)}"
    )
