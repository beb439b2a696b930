"""FAPM: the graph against the oracle, each repair against the published behaviour, and hard nominal sets."""

import numpy as np
import pytest
from heads import fit, grid, parity, presses_of, stored_bytes

from edge.core.detector import Grid, Mode
from edge.core.errors import FitError
from plugins.detectors.fapm import FapmParameters, fapm

MODES = ("paper", "corrected")
TAPS = {"layer2": (6, 8, 8), "layer3": (8, 4, 4)}


def choices(mode: Mode = "corrected", **overrides: object) -> FapmParameters:
    """A mode's parameters on the two layers of TAPS."""
    return fapm.parameters(mode, **{"layers": ("layer2", "layer3"), "pooling": 3, **overrides})


def at(taps: dict[str, tuple[int, int, int]] = TAPS) -> Grid:
    return Grid((32, 32), taps, 15.77)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("banks", ["cell", "location"])
@pytest.mark.parametrize("n", [1, 2, 11, 25])
def test_the_graph_is_the_oracle(mode: str, banks: str, n: int) -> None:
    """Map and score agree to 1e-5, also with fewer prototypes than neighbours, for several presses at once."""
    p = choices(mode, banks=banks, weighting="largest")
    _, map_error, score_error = parity(fapm, p, presses_of(n, 0, TAPS), presses_of(3, 1, TAPS), at())
    assert map_error < 1e-5
    assert score_error < 1e-5


@pytest.mark.parametrize("banks", ["cell", "location"])
def test_a_grid_that_ends_inside_a_cell(banks: str) -> None:
    """Cells cut off by the border have their own prototypes and scores (a 720 line frame has 22.5 cells)."""
    taps = {"layer2": (4, 9, 6), "layer3": (5, 5, 3)}
    p = choices(banks=banks)
    oracle, map_error, _ = parity(
        fapm, p, presses_of(6, 0, taps), presses_of(2, 1, taps), Grid((72, 48), taps, 15.77)
    )
    assert map_error < 1e-5
    assert (oracle.score_map > 0).all()


def test_a_shared_cell_forgives_a_small_shift() -> None:
    """Repair: prototypes shared within a cell find content that moved by one sub-patch; per place they do not."""
    taps = {"layer2": (6, 4, 4), "layer3": (8, 2, 2)}
    place = Grid((32, 32), taps, 15.77)
    nominal = presses_of(10, 0, taps, spread=0.01)
    moved = {tap: maps[:1].copy() for tap, maps in nominal.items()}
    moved["layer2"] = np.roll(moved["layer2"], 1, axis=3)
    score = {}
    for banks in ("cell", "location"):
        p = choices(banks=banks, near_fraction=1.0, is_calibrated=False)
        bank = fit(fapm, p, nominal, place)
        usual = fapm.reference_score(presses_of(1, 5, taps, spread=0.01), place, bank, p).score_map
        score[banks] = fapm.reference_score(moved, place, bank, p).score_map.mean() / usual.mean()
    assert score["cell"] < 0.7 * score["location"]


def test_calibration_lowers_the_restless_cells() -> None:
    """Repair: where nominal presses vary ten times more, the calibrated map of a nominal press is not much higher."""
    taps = {"layer2": (6, 16, 16), "layer3": (8, 8, 8)}
    place = Grid((64, 64), taps, 15.77)
    nominal, asked = _restless(30, 0, taps), _restless(10, 1, taps)
    ratio = {}
    for is_calibrated in (True, False):
        p = choices(is_calibrated=is_calibrated, sigma=0.0)
        bank = fit(fapm, p, nominal, place)
        raw = fapm.reference_score(asked, place, bank, p).score_map
        ratio[is_calibrated] = raw[:, 4:12, 4:12].mean() / raw[:, 32:, 32:].mean()
    assert ratio[True] < 1.5
    assert ratio[False] > 4


def _restless(n: int, seed: int, taps: dict[str, tuple[int, int, int]]) -> dict[str, np.ndarray]:
    """Noise around zero, ten times stronger in the upper left cell."""
    rng = np.random.default_rng(seed)
    found = {}
    for tap, shape in taps.items():
        noise = rng.normal(0, 0.1, (n, *shape))
        noise[..., : shape[1] // 4, : shape[2] // 4] *= 10
        found[tap] = noise.astype(np.float32)
    return found


def test_restless_cells_get_the_far_bank() -> None:
    """The tenth of the cells with rows farthest from their near bank keeps twice as many prototypes; the rest near."""
    nominal = presses_of(20, 0, TAPS, spread=0.01)
    for maps in nominal.values():
        half = maps.shape[2] // 2
        maps[:, :, :half, :half] *= np.random.default_rng(0).uniform(0, 4, (20, 1, 1, 1)).astype(np.float32)
    bank = fit(fapm, choices(), nominal, at())
    assert bank.arrays["layer2_far_places"][:, 0].tolist() == [0]
    assert bank.arrays["layer2_near_places"][:, 0].tolist() == [4, 32, 36]
    near, far = bank.arrays["layer2_near"].shape[1], bank.arrays["layer2_far"].shape[1]
    assert (near, far) == (int(0.1 * 20 * 16), 2 * int(0.1 * 20 * 16))


def test_one_prototype_is_the_least() -> None:
    """A tenth of nine presses is still one prototype per place."""
    bank = fit(fapm, choices(banks="location"), presses_of(9, 0, TAPS), at())
    assert bank.arrays["layer2_near"].shape[1] == 1


def test_the_prototypes_fit_into_the_bank() -> None:
    """`auto` stores float16, int8 where that is too large, then fewer prototypes, with a warning."""
    taps = {"layer1": (64, 8, 8)}
    nominal = presses_of(40, 0, taps)
    whole = fit(fapm, fapm.parameters(), nominal, at(taps))
    for part, packing, warns in ((1.01, "float16", 0), (0.7, "int8", 0), (0.4, "int8", 1)):
        room = part * stored_bytes(whole)
        bank = fit(fapm, fapm.parameters(bank_mb=room / 1e6), nominal, at(taps))
        assert bank.packing["layer1_near"] == packing
        assert len(bank.facts["warnings"]) == warns
        assert (bank.facts["near_fraction"] < 0.1) == warns
        assert stored_bytes(bank) <= room


def test_layers_that_do_not_follow_each_other_are_refused() -> None:
    """The coarse layer must be half of the fine one."""
    with pytest.raises(FitError, match="follow each other"):
        fit(fapm, fapm.parameters(layers=("layer1", "layer3")), presses_of(3), grid())
