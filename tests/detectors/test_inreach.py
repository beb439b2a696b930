"""InReaCh: the graph against the oracle, channels worked by hand, each repair against the published behaviour."""

import numpy as np
import pytest
from heads import RESNET18, fit, grid, parity, presses_of, with_spot

from edge.core.detector import Grid
from plugins.detectors.inreach import channels, inreach
from plugins.detectors.inreach.channels import Channels, associate, prune
from plugins.detectors.inreach.paper import PAPER_TAPS

MODES = ("paper", "corrected")
# The published descriptor on a trunk that lacks its taps.
HERE = {"taps": ("layer1", "layer2", "layer3"), "grid_tap": "layer1"}


def parameters(mode: str, **overrides: object) -> object:
    return inreach.parameters(mode, **(HERE if mode == "paper" else {}) | overrides)


@pytest.mark.parametrize(
    ("mode", "choice"),
    [
        ("paper", {"grid_tap": "layer2"}),
        ("corrected", {"grid_tap": "layer2", "descriptor": "binned"}),
        ("corrected", {"grid_tap": "layer2", "descriptor": "means", "dims": 20}),
        ("corrected", {"taps": ("layer1",), "dims": 20}),
        ("corrected", {"taps": ("layer1",)}),
    ],
)
def test_the_graph_is_the_oracle_on_a_real_trunk(mode: str, choice: dict[str, object]) -> None:
    """The same with the tap sizes of a ResNet-18 on the 224 crop, several taps and one, every kind of descriptor."""
    nominal, asked = presses_of(4, 0, RESNET18), with_spot(presses_of(1, 1, RESNET18))
    p = inreach.parameters(mode, is_fallback=True, **HERE | choice)
    _, map_error, score_error = parity(inreach, p, nominal, asked, grid(RESNET18))
    assert map_error < 1e-4
    assert score_error < 1e-4


def test_the_published_taps() -> None:
    """The paper's mode reads thirteen blocks of Wide-ResNet-50-2 and works with all of them at once."""
    taps = {tap: (6, *(16 >> int(tap[5]),) * 2) for tap in PAPER_TAPS}
    assert inreach.taps(inreach.parameters("paper")) == PAPER_TAPS
    at = Grid((32, 32), taps, 15.77)
    _, map_error, _ = parity(
        inreach,
        inreach.parameters("paper", is_fallback=True),
        presses_of(5, 0, taps),
        presses_of(1, 1, taps),
        at,
    )
    assert map_error < 1e-5


def test_channels_by_hand() -> None:
    """Three presses of two patches: the second patch of the third has no mutual neighbour."""
    rows = np.array([[[0.0], [10.0]], [[1.0], [11.0]], [[0.4], [0.6]]], np.float32)
    found = associate(rows, inreach.parameters())
    members = {}
    for key, press, patch in zip(*found, strict=True):
        members.setdefault(int(key), []).append((int(press), int(patch)))
    # Patch 0 of press 0 (key 0): joined by patch 0 of press 1 and patch 0 of press 2 (0.4 away; mutual).
    # Patch 0 of press 1 (key 2): joined by patch 1 of press 2 (0.4 away; mutual). 10 and 11 match each other (key 1).
    assert members == {0: [(0, 0), (1, 0), (2, 0)], 1: [(0, 1), (1, 1)], 2: [(1, 0), (2, 1)]}


def test_a_patch_joins_the_closest_mutual_realisation() -> None:
    """Repair: published, a patch whose closest realisation has a better partner is lost; ours joins the next one."""
    # Press 2's patch 0 is closest to press 1's patch 0, which prefers press 2's patch 1; press 0's patch 0 prefers it.
    rows = np.array([[[2.0], [50.0]], [[1.0], [60.0]], [[1.4], [1.1]]], np.float32)
    for is_sought, joins in ((True, True), (False, False)):
        found = associate(rows, inreach.parameters(is_mutual_sought=is_sought))
        chosen = found.key[(found.press == 2) & (found.patch == 0)]
        assert (chosen.tolist() == [0]) == joins


def test_short_channels_depend_on_the_number_of_presses() -> None:
    """Repair: the published rule (more than 3) leaves a small set without a bank; ours requires a share."""
    published, relative = parameters("paper"), parameters("corrected")
    assert [published.shortest(n) for n in (5, 22, 76)] == [4, 4, 4]
    assert [relative.shortest(n) for n in (5, 22, 40, 76)] == [2, 2, 2, 4]
    rows = presses_of(3)["layer1"].reshape(3, 6, -1).swapaxes(1, 2)
    assert not len(prune(rows, associate(rows, published), published).key)
    assert len(prune(rows, associate(rows, relative), relative).key)


def test_dispersion_is_a_multiplier() -> None:
    """The paper's 5.0 times the deviation of the distances to the mean: scale-free, and it drops a far stray."""
    rng = np.random.default_rng(0)
    p = inreach.parameters("paper", max_dispersion=3.0)
    for scale in (1.0, 1000.0):
        rows = (rng.normal(size=(30, 1, 1)) * scale).astype(np.float32)
        rows[7] = 40 * scale
        channels = Channels(np.zeros(30, np.int64), np.arange(30), np.zeros(30, np.int64))
        kept = prune(rows, channels, p)
        assert 7 not in kept.press
        assert len(kept.press) >= 25


def test_wide_channels_are_dropped() -> None:
    """Repair: a channel wider than the stray distance is dropped, even if it is uniform by its own spread."""
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(20, 40, 2)).astype(np.float32)
    rows[:, 0] *= 100
    channels = Channels(
        np.repeat(np.arange(40), 20), np.tile(np.arange(20), 40), np.repeat(np.arange(40), 20)
    )
    for is_limited in (True, False):
        kept = prune(rows, channels, inreach.parameters(is_spread_limited=is_limited))
        assert (0 not in kept.key) == is_limited


def test_strays_among_the_presses_stay_out_of_the_bank() -> None:
    """One nominal press with a defective patch: the patch joins no channel, and is still anomalous afterwards."""
    nominal = presses_of(20, spread=0.05)
    spoiled = with_spot({tap: maps[4:5] for tap, maps in nominal.items()}, 0.5)
    for tap, maps in nominal.items():
        maps[4:5] = spoiled[tap]
    p = parameters("corrected", most_rows=None, dims=None)
    bank = fit(inreach, p, nominal, grid())
    map_of_spoiled = inreach.reference_score(spoiled, grid(), bank, p).score_map[0]
    usual = inreach.reference_score(presses_of(1, 9, spread=0.05), grid(), bank, p).score_map[0]
    assert map_of_spoiled[16:24, 16:24].max() > 3 * usual.max()


def test_the_bank_is_thinned_by_k_centre() -> None:
    """most_rows is kept, and the radius is in the facts."""
    bank = fit(inreach, parameters("corrected", most_rows=9), presses_of(8), grid(), seed=2)
    assert len(bank.arrays["bank"]) == 9
    assert bank.facts["radius"] > 0


@pytest.mark.parametrize("rows_at_once", [1, 5])
def test_slices_of_a_product_change_no_channel(rows_at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Channels are the same where a press is compared with a realisation in slices, which large frames need."""
    rows = np.random.default_rng(0).integers(-8, 8, (6, 12, 4)).astype(np.float32)
    at_once = associate(rows, inreach.parameters())
    monkeypatch.setattr(channels, "PRODUCT_LIMIT", rows_at_once * 12)
    for ours, expected in zip(associate(rows, inreach.parameters()), at_once, strict=True):
        assert np.array_equal(ours, expected)
    assert len(at_once.key) > 6
