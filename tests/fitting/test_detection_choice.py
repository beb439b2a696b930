"""A fit chooses the method and the trunk whose banks see more of small damage in its own presses, and says why."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pressed_dome import dome_config, dome_presses

from calibration.fitting.candidates import Candidates
from calibration.fitting.damage_seen import DamageJudge, Separation
from calibration.fitting.detection_choice import Comparison, choose_detection
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import Trunk, open_trunk
from edge import registry
from edge.core.detector import Detector
from edge.core.errors import FitError
from edge.model.manifest_facts import BACKBONE_CHOICE, METHOD_CHOICE, choice_sentence
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk

TACTILE, LITE = "tactile_resnet18", "tactile_lite0"
KNOWN = f"known: {', '.join(registry.names('backbones'))}, or a path to a trunk .onnx file"
KINDS = ("rendered damage", "pieces of relief")


@pytest.fixture(scope="module")
def presses() -> NominalPresses:
    """Six presses of a dome."""
    return dome_presses(6)


@pytest.fixture(scope="module")
def config() -> FitConfig:
    return dome_config(folds=2)


@pytest.fixture(scope="module")
def random_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trunk") / "random.onnx"
    path.write_bytes(build_trunk(random_state("resnet18"), "resnet18", ("layer1", "layer2", "layer3")))
    return path


def test_the_pair_that_sees_more_is_chosen(
    presses: NominalPresses, config: FitConfig, random_weights: Path
) -> None:
    """Trained weights and not random ones, with the figures of all methods on both; a trunk that cannot be tried is
    named. The configuration has the method and a trunk that it can read; the manifest keeps both sentences."""
    candidates = Candidates(("padim", "subspace"), (str(random_weights), TACTILE, "nothing"))
    chosen = choose_detection(presses, config, candidates)
    taps = chosen.detector.taps(chosen.detector.parameters("corrected"))
    assert chosen.trunk.graph == open_trunk(TACTILE, taps).graph
    method, backbone = (chosen.choice_facts[name] for name in ("method_choice", "backbone_choice"))
    why, left_out = backbone["why"].split("; nothing", 1)
    assert why.startswith(f"{TACTILE}: of rendered damage and pieces of relief in the nominal presses its")
    assert left_out == " was not tried: no backbone is named 'nothing'; " + KNOWN
    assert {kind for of in backbone["found"].values() for kind in of} == set(KINDS)
    trunks = {name: np.mean(list(of.values())) for name, of in backbone["found"].items()}
    assert trunks[TACTILE] > trunks["random.onnx"] > 0
    methods = {name: np.mean(list(of[TACTILE].values())) for name, of in method["found"].items()}
    assert set(methods) == set(candidates.methods)
    assert method["chosen"] == chosen.detector.name == max(methods, key=lambda name: methods[name])
    fitted = fit_files(presses, replace(chosen, threshold=9.0), created="").manifest
    assert fitted.method == method["chosen"]
    assert choice_sentence(fitted.facts, METHOD_CHOICE) == method["why"]
    assert choice_sentence(fitted.facts, BACKBONE_CHOICE) == backbone["why"]


class SaidSeen(DamageJudge):
    """What was said that each pair sees, in place of a judgement."""

    def __init__(self, said: dict[tuple[str, str], Separation | FitError]) -> None:
        self.said = said

    def judge(
        self, trunk: Trunk, taps: Sequence[str], detectors: Mapping[str, Detector]
    ) -> dict[str, Separation | FitError]:
        return {name: self.said[name, trunk.id] for name in detectors}


def seen(mean: float, press_ms: float = 5.0, is_registered: bool = False) -> Separation:
    return Separation(dict.fromkeys(KINDS, mean), press_ms, is_registered)


PAIRS = Candidates(("padim", "patchcore"), (TACTILE, LITE))


def compared(config: FitConfig, said: dict[tuple[str, str], Separation | FitError]) -> FitConfig:
    comparison = Comparison(config, PAIRS)
    comparison.run(SaidSeen(said), lambda stage, fraction: None)
    return comparison.choose()


def test_method_and_trunk_are_chosen_together(config: FitConfig) -> None:
    """The best of all pairs. Each method is said with its time on its better trunk, each trunk with that method."""
    chosen = compared(
        config,
        {
            ("padim", TACTILE): seen(0.4, 7.25, is_registered=True),
            ("padim", LITE): seen(0.3, 8.0, is_registered=True),
            ("patchcore", TACTILE): seen(0.5, 3.0),
            ("patchcore", LITE): seen(0.6, 4.0),
        },
    )
    assert (chosen.detector.name, chosen.trunk.id) == ("patchcore", LITE)
    method, trunk = (
        choice_sentence(chosen.choice_facts, choice) for choice in (METHOD_CHOICE, BACKBONE_CHOICE)
    )
    assert "padim 0.400, 7.2 ms a press with registration; patchcore 0.600, 4.0 ms a press" in method
    assert trunk.startswith(f"{LITE}: ")
    assert f"{TACTILE} 0.500, {LITE} 0.600" in trunk
    assert chosen.choice_facts["backbone_choice"]["found"][LITE] == dict.fromkeys(KINDS, 0.6)
    named = Comparison(config, Candidates(("padim",), (TACTILE, LITE)))
    named.run(
        SaidSeen({("padim", trunk): seen(0.5) for trunk in (TACTILE, LITE)}), lambda stage, fraction: None
    )
    assert "method_choice" not in named.choose().choice_facts


def test_what_cannot_be_tried_is_left_out_and_said(config: FitConfig) -> None:
    """A method that refuses the presses, a trunk without its tap; with nothing left the refusal is the fit's."""
    refused = FitError("half of the contacts lie more than 4.0 mm from their middle")
    said: dict[tuple[str, str], Separation | FitError] = {
        ("padim", TACTILE): refused,
        ("padim", LITE): refused,
        ("patchcore", TACTILE): FitError("the trunk has no such tap"),
        ("patchcore", LITE): seen(0.2),
    }
    chosen = compared(config, said)
    assert (chosen.detector.name, chosen.trunk.id) == ("patchcore", LITE)
    assert choice_sentence(chosen.choice_facts, METHOD_CHOICE).endswith(f"; padim was not tried: {refused}")
    assert choice_sentence(chosen.choice_facts, BACKBONE_CHOICE).endswith(
        f"; {TACTILE} was not tried: the trunk has no such tap"
    )
    with pytest.raises(FitError, match=r"more than 4\.0 mm from their middle"):
        compared(config, dict.fromkeys(said, refused))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda p, c: (replace(p, no_contact=None), c), "give one with --no-contact"),
        (lambda p, c: (p.spread(3), c), "of fewer than 4 presses nothing can be held out"),
        (lambda p, c: (p, replace(c, mode="paper")), "the published methods have no choice"),
        (
            lambda p, c: (replace(p, frames=np.repeat(p.no_contact[:1], len(p), axis=0)), c),
            "no damage shows in the presses",
        ),
    ],
)
def test_the_usual_trunk_is_kept_where_nothing_can_be_compared(
    presses: NominalPresses,
    config: FitConfig,
    change: Callable[..., tuple[NominalPresses, FitConfig]],
    why: str,
) -> None:
    """Without a picture of the free gel, with few presses, in the mode `paper`, and where presses show nothing. There
    `--method auto` is refused."""
    presses, config = change(presses, config)
    chosen = choose_detection(presses, config, Candidates(("padim",), (TACTILE, LITE)))
    assert chosen.trunk is config.trunk
    said = choice_sentence(chosen.choice_facts, BACKBONE_CHOICE)
    assert said.startswith(f"{TACTILE}, without a comparison: ")
    assert said.endswith(why)
    with pytest.raises(
        FitError, match=f"no method can be chosen: .*{why}; name one with --method, such as padim"
    ):
        choose_detection(presses, config, PAIRS)
