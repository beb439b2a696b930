"""The detectability card of a bundle: the smallest damage that it finds, by place, in millimetres.

It is an entry of the manifest's `facts`, which hold what was learnt about a bundle. So a program that does not know
cards reads the bundle all the same.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from edge.core.errors import BundleCorrupt
from edge.model.manifest_files import Entry

__all__ = ["CARD", "DetectabilityCard", "JudgedBy", "KindCard", "State", "detectability_lines", "read_card"]

CARD = "detectability"
"""The card's name among the manifest's facts."""

JudgedBy = Literal["presses apart", "folds", "third party's graph"]

Size = Annotated[float, Field(gt=0)]
State = Literal["fitted", "separated", "blind", "too few"]


class KindCard(Entry):
    """One kind of damage. Sizes in mm, None where they lie beyond `largest_mm`, the largest size tried.

    a90_mm, a90_95_mm: over all places, the size found in 90 % of cases, best estimate and 95 % sure. place_*: the same
    at each place, in the order of the card's places. state: how the curve was found, `blind` where nothing is found.
    """

    kind: str
    largest_mm: Size
    trials: int = Field(ge=1)
    found: int = Field(ge=0)
    a90_mm: Size | None
    a90_95_mm: Size | None
    place_a90_mm: tuple[Size | None, ...]
    place_a90_95_mm: tuple[Size | None, ...]
    place_state: tuple[State, ...]


class DetectabilityCard(Entry):
    """The smallest damage that a bundle finds. places: the middle of each, (x, y) in mm from the middle of the region.

    presses: how many were edited. judged_by: `presses apart` from the fit, by the bundle itself; or `folds`, learnt
    presses by banks fitted without them. false_alarms: presses that fail without damage; they are not edited.
    """

    created: str
    presses: int = Field(ge=1)
    false_alarms: int = Field(ge=0)
    judged_by: JudgedBy
    spacing_mm: Size
    places: tuple[tuple[float, float], ...]
    kinds: tuple[KindCard, ...]

    @model_validator(mode="after")
    def _complete(self) -> "DetectabilityCard":
        for kind in self.kinds:
            for column in (kind.place_a90_mm, kind.place_a90_95_mm, kind.place_state):
                if len(column) != len(self.places):
                    raise ValueError(f"{kind.kind} has {len(column)} sizes for {len(self.places)} places")
        return self


def read_card(facts: Mapping[str, Any]) -> DetectabilityCard | None:
    """Read the card among a manifest's facts, None where it has none. Errors: BundleCorrupt for one that is damaged."""
    try:
        return None if CARD not in facts else DetectabilityCard.model_validate(facts[CARD])
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(map(str, ("facts", CARD, *fault["loc"])))
        raise BundleCorrupt(
            f"manifest.json is wrong: {where}: {fault['msg']}; measure it again with `gelgate lab detectability`"
        ) from error


def detectability_lines(card: DetectabilityCard) -> list[str]:
    """Say in one sentence for each kind of damage what is detected of it."""
    return [f"{kind.kind}: {_sentence(kind)}" for kind in card.kinds]


def _sentence(kind: KindCard) -> str:
    sizes = [size for size in kind.place_a90_95_mm if size is not None]
    blind = kind.place_state.count("blind")
    unknown = len(kind.place_state) - len(sizes) - blind
    phrases = []
    if sizes:
        spread = (
            f"{min(sizes):.2g} mm" if min(sizes) == max(sizes) else f"{min(sizes):.2g} to {max(sizes):.2g} mm"
        )
        phrases.append(
            f"found in 90 % of cases, 95 % sure, from {spread} at {len(sizes)} of {len(kind.place_state)} places"
        )
    if unknown:
        phrases.append(f"not shown up to {kind.largest_mm:g} mm at {unknown}")
    if blind:
        phrases.append(f"blind at {blind}")
    anywhere = "not shown" if kind.a90_95_mm is None else f"from {kind.a90_95_mm:.2g} mm"
    return ", ".join(phrases) + f"; anywhere {anywhere}"
