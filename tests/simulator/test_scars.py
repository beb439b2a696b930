"""What a scar of a simulated gel shows, and when it exists."""

import numpy as np
import pytest

from calibration.simulator.field_of_view import LR
from calibration.simulator.scars import SCARS, Scar, random_scar

DENT = Scar("dent", (0.0, 0.0), 0.0, 0.8, 0.08, since=3, growth=5)


def test_a_scar_grows_evenly_to_its_full_size() -> None:
    """Not there before its press, a fifth with it, full four presses later and from then on."""
    assert [DENT.share(press) for press in (2, 3, 5, 7, 50)] == pytest.approx([0, 0.2, 0.6, 1, 1])


@pytest.mark.parametrize("kind", SCARS)
def test_each_kind_changes_the_gel_near_its_spot_alone(kind: str) -> None:
    """Furrows and dents go down, hairs up; worn coat changes the light and no height."""
    scar = random_scar(kind, (2.0, -1.0), 0, np.random.default_rng(3))
    relief, coat = scar.relief(LR), scar.coat(LR)
    changed = (np.abs(relief) > 1e-4) | (coat < 0.999)
    rows, columns = np.nonzero(changed)
    away = np.hypot((columns - 159.5) * 0.0634 - 2.0, (rows - 119.5) * 0.0634 + 1.0)

    assert 0 < changed.sum() < 6000
    assert away.max() < 5
    assert (relief.min() < 0, relief.max() > 0, coat.min() < 1) == (
        kind in ("scratch", "dent"),
        kind == "hair",
        kind == "worn_coat",
    )
