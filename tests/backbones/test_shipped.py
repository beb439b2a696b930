"""The shipped backbone: its files are those of the facts, it works as a trunk, and its evaluation is current."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from graph_session import open_graph

from calibration.experiments.backbones.sets import SETS
from calibration.experiments.harness.study import methods_to_compare
from calibration.fitting.trunks import open_trunk
from calibration.training.package import MOST_BYTES
from calibration.training.train_config import TrainConfig
from edge import registry
from edge.core.errors import ConfigError
from plugins.backbones.tactile import FixedTrunk, read_file, tactile_resnet18, tactile_resnet18_int8

ROOT = Path(__file__).parents[2]
HOME = ROOT / "plugins" / "backbones"
FACTS = json.loads((HOME / "tactile_resnet18.json").read_text())
EVALUATION = json.loads((HOME / "tactile_resnet18_evaluation.json").read_text())


def test_it_is_the_file_of_the_facts() -> None:
    """It has the recorded bytes, within the limit, and says how it was trained."""
    trunk = open_trunk("tactile_resnet18")
    assert trunk.id == tactile_resnet18.name == "tactile_resnet18"
    recorded = FACTS["variants"]["tactile_resnet18"]
    assert hashlib.sha256(trunk.graph).hexdigest() == recorded["sha256"]
    assert len(trunk.graph) == recorded["bytes"] <= MOST_BYTES
    assert f"{FACTS['trained_steps']} steps" in str(trunk.facts["weights"])
    assert trunk.facts["licence"] == "Apache-2.0"


@pytest.mark.parametrize("backbone", [tactile_resnet18, tactile_resnet18_int8])
def test_it_answers_as_every_trunk_does(backbone: FixedTrunk) -> None:
    """Frames uint8 (n, h, w, 3) to layer1, layer2 and layer3 at strides 4, 8 and 16, positive and finite."""
    graph = backbone.trunk()
    assert hashlib.sha256(graph).hexdigest() == FACTS["variants"][backbone.name]["sha256"]
    session = open_graph(graph)
    frames = np.random.default_rng(0).integers(0, 256, (2, 64, 96, 3), dtype=np.uint8)
    maps = session.run(["layer1", "layer2", "layer3"], {"frames": frames})
    assert [m.shape for m in maps] == [(2, 64, 16, 24), (2, 128, 8, 12), (2, 256, 4, 6)]
    assert all(np.isfinite(m).all() and m.min() >= 0 < m.max() for m in maps)


def test_what_is_not_there_is_refused() -> None:
    """An unknown tap, with the known ones, and a file that this installation lacks."""
    assert tactile_resnet18.trunk(("layer2",)) == tactile_resnet18.trunk()
    with pytest.raises(ConfigError, match=r"gives layer1, layer2, layer3, requested were layer4"):
        tactile_resnet18.trunk(("layer2", "layer4"))
    with pytest.raises(ConfigError, match=r"'nowhere\.onnx' is missing from this installation"):
        read_file("nowhere.onnx")


def test_the_default_recipe_is_that_of_the_run_that_ships() -> None:
    """`gelgate lab train-backbone RUN` without any setting learns with the settings of these weights."""
    assert TrainConfig.from_json(json.dumps(FACTS["recipe"])) == TrainConfig.shipped()
    assert FACTS["trained_steps"] == TrainConfig.shipped().steps
    assert FACTS["before"] == []


def test_the_evaluation_is_of_these_weights_and_settings() -> None:
    """The trunks that were compared are the files that ship, and the detectors read what they read today. A parameter
    that came later is not among the settings: its default changes nothing. The switches of published defects are the
    published variant's, off unless named."""
    for name, variant in (("trained", "tactile_resnet18"), ("trained_int8", "tactile_resnet18_int8")):
        assert EVALUATION["trunks"][name]["sha256"] == FACTS["variants"][variant]["sha256"]
    for method, settings in EVALUATION["settings"].items():
        switches = type(registry.detector(method).parameters("paper")).model_fields
        unnamed = {name: field.default for name, field in switches.items()}
        today = json.loads(json.dumps({**unnamed, **vars(registry.detector(method).parameters())}))
        assert settings == {name: today[name] for name in settings}


def test_every_set_was_evaluated() -> None:
    """No table of the card is missing, and each compares random weights with those that ship. Its file says of real
    touch where the table is."""
    for name in SETS:
        assert {"trained", "random"} <= {row["backbone"] for row in EVALUATION["sets"][name]["rows"]}


@pytest.mark.parametrize("name", ["random-parts", "parts", "sensor"])
def test_it_is_better_than_random_on_what_it_never_saw(name: str) -> None:
    """In the shipped evaluation every detector has a higher AU-PRO on unseen parts than with random weights, and loses
    less than 0.005 of it with the int8 trunk."""
    found = {
        (row["backbone"], row["detector"]): row["measures"]["aupro_fpr01"]["value"]
        for row in EVALUATION["sets"][name]["rows"]
    }
    for detector in methods_to_compare():
        assert found["trained", detector] > found["random", detector]
        assert found["trained_int8", detector] > found["trained", detector] - 0.005
