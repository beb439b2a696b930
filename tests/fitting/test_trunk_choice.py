"""A fit chooses the trunk whose banks see more of small damage put into its own presses, and says why."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, Bench

from calibration.fitting.damaged_presses import DamagedPresses
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.held_out import HeldOut, ScoredPresses
from calibration.fitting.nominal_presses import NominalPresses, named_presses
from calibration.fitting.trunk_choice import choose_trunk, separated
from calibration.fitting.trunks import Trunk, open_trunk
from calibration.simulator.pose import Jitter
from calibration.simulator.renderer import Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from edge import registry
from edge.model.limit_facts import backbone_sentence
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

TACTILE = "tactile_resnet18"
KNOWN = f"known: {', '.join(registry.names('backbones'))}, or a path to a trunk .onnx file"


@pytest.fixture(scope="module")
def presses() -> NominalPresses:
    """Six presses of a dome."""
    with reproducible_opencv():
        bench = Bench(Renderer(jitter=Jitter(0.03, 0.2, 0.05, 0.01)))
        pictures = {f"p{k}": bench.press(k) for k in range(6)}
        return named_presses(pictures, PROFILE, REGION, no_contact=[bench.free()])


@pytest.fixture(scope="module")
def config() -> FitConfig:
    padim = registry.detector("padim")
    trunk = open_trunk(TACTILE, padim.taps(padim.parameters("corrected")))
    return FitConfig("dome", "top", PROFILE, REGION, padim, trunk, threads=1, folds=2)


@pytest.fixture(scope="module")
def random_weights() -> Trunk:
    return Trunk("random", build_trunk(random_state("resnet18"), "resnet18", ("layer1",)))


def test_the_trunk_that_sees_more_is_chosen(
    presses: NominalPresses, config: FitConfig, random_weights: Trunk
) -> None:
    """Trained weights and not random ones, with the figures of both; one that cannot be tried is named. The fit keeps
    the sentence in the manifest."""
    choice = choose_trunk(presses, replace(config, trunk=random_weights), (TACTILE, "nothing"))
    assert choice.trunk.id == TACTILE
    why, left_out = choice.why.split("; ", 1)
    assert why.startswith(f"{TACTILE}: of rendered damage and pieces of relief in the nominal presses its")
    assert left_out.endswith("nothing was not tried: no backbone is named 'nothing'; " + KNOWN)
    assert {kind for of in choice.found.values() for kind in of} == {"rendered damage", "pieces of relief"}
    seen = {name: np.mean(list(of.values())) for name, of in choice.found.items()}
    assert seen[TACTILE] > seen["random"] > 0
    kept = replace(config, trunk_choice=choice.facts(), threshold=9.0)
    assert backbone_sentence(fit_files(presses, kept, created="").manifest.facts) == choice.why


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"no_contact": None}, "give one with --no-contact"),
        ({"few": 3}, "of fewer than 4 presses nothing can be held out"),
        ({"mode": "paper"}, "the published methods have no choice"),
        ({"flat": True}, "no damage shows in the presses"),
    ],
)
def test_the_usual_trunk_is_kept_where_nothing_can_be_compared(
    presses: NominalPresses, config: FitConfig, change: dict[str, object], why: str
) -> None:
    """Without a picture of the free gel, with few presses, in the mode `paper`, and where presses show nothing."""
    if "few" in change:
        presses = presses.spread(3)
    elif "flat" in change:
        assert presses.no_contact is not None
        presses = replace(presses, frames=np.repeat(presses.no_contact[:1], len(presses), axis=0))
    elif "mode" in change:
        config = replace(config, mode="paper")
    else:
        presses = replace(presses, no_contact=None)
    choice = choose_trunk(presses, config, ("tactile_lite0",))
    assert choice.trunk is config.trunk
    assert choice.why.startswith(f"{TACTILE}, without a comparison: ")
    assert choice.why.endswith(why)


def test_many_presses_are_judged_by_some_of_them(presses: NominalPresses) -> None:
    """Evenly spread, each with its name and its touch; few are taken as they are."""
    some = presses.spread(3)
    assert some.names == tuple(presses.names[k] for k in (0, 2, 5))
    assert some.touches == tuple(presses.touches[k] for k in (0, 2, 5))
    assert np.array_equal(some.frames, presses.frames[[0, 2, 5]])
    assert presses.spread(6) is presses


def shown(damaged_maps: np.ndarray) -> HeldOut:
    """Two sound presses with an empty map, and damaged ones with these maps."""
    sound = ScoredPresses(np.zeros((2, 8, 8), np.float32), np.zeros(2))
    return HeldOut(sound, ScoredPresses(damaged_maps, damaged_maps.max(axis=(1, 2)).astype(np.float64)))


@pytest.mark.parametrize(
    ("at", "expected"),
    [(("on",), 1.0), (("off",), 0.5), (("on", "off"), 0.734), ((), 0.25)],
)
def test_what_is_seen_is_half_the_press_and_half_the_place(at: tuple[str, ...], expected: float) -> None:
    """Seen at its place alone 1; found somewhere else a half, for the press; nothing seen a quarter, as by chance."""
    masks = np.zeros((1, 8, 8), np.bool_)
    masks[0, :2, :2] = True
    maps = np.zeros((1, 8, 8), np.float32)
    if "on" in at:
        maps[masks] = 1.0
    if "off" in at:
        maps[0, 7, 7] = 2.0
    damaged = DamagedPresses(np.zeros((1, 8, 8, 3), np.uint8), np.zeros(1, np.int64), masks)
    assert separated(shown(maps), slice(0, 1), damaged) == pytest.approx(expected, abs=0.01)
