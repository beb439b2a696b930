"""A picture of the free gel that does not belong to the presses is named, and one that does is not."""

import numpy as np
from press_films import PARTS, series

from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import ReliefOfReference
from edge.core.contact.wear import foreign_free_gel, foreign_start


def other_light(view: View) -> View:
    """A lamp on one side is brighter, by more than a gain and an offset explain."""
    columns, rows = np.linspace(-1, 1, 160, dtype=np.float32), np.linspace(-1, 1, 120, dtype=np.float32)
    lit = 45 * np.clip(columns, 0, 1)[None, :, None] * np.abs(rows)[:, None, None]
    return np.clip(view + lit * np.array([1, 0.3, -0.8], np.float32), 0, 255).astype(np.float32)


def contacts(part: str, free: View) -> tuple[list[Touch], list[float]]:
    reference = Reference(free)
    differences = [reference.difference(view) for view in series(part, "clear")[9:14]]
    structure = ReliefOfReference(free)
    return (
        [touched(touched_mask(difference)) for difference in differences],
        [structure.of(difference, 3.5).area for difference in differences],
    )


def test_a_free_gel_of_another_light_is_named() -> None:
    """The touched area is the light's: many times the relief, and the same for every press."""
    said = foreign_free_gel(*contacts("ball", other_light(series("ball", "clear")[0])))
    assert said is not None
    assert "most likely of another light" in said


def test_a_free_gel_of_the_same_light_is_not() -> None:
    """Whatever the part; two presses are too few to say."""
    for part in PARTS:
        assert foreign_free_gel(*contacts(part, series(part, "clear")[0])) is None
    assert foreign_free_gel([Touch(0.3)] * 2, [0.01] * 2) is None


def test_a_start_in_another_light_is_named() -> None:
    """The free gel is compared with the one at the fit: the same is silent, another light is said, a part is not."""
    views = series("PZ3", "clear")
    free = Reference(views[0])
    assert foreign_start(free, free) is None
    assert foreign_start(Reference(views[0] * np.float32(0.85)), free) is None
    assert foreign_start(Reference(views[12]), free) is None
    said = foreign_start(Reference(other_light(views[0])), free)
    assert said is not None
    assert "another light" in said
