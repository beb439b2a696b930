"""Where the trunk of a fit comes from: a file, or an installed backbone asked for its taps."""

from pathlib import Path

import pytest
import tiny

from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.core.errors import ConfigError, FitError
from edge.model.onnx_validation import output_names
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk


def test_a_trunk_comes_from_a_file_or_by_name(tmp_path: Path) -> None:
    """A path ends in .onnx; a name is an installed backbone; anything else is a sentence with the known names."""
    (tmp_path / "mine.onnx").write_bytes(tiny.tiny_trunk())
    assert open_trunk(str(tmp_path / "mine.onnx")).id == "mine"
    with pytest.raises(FitError, match="cannot be read"):
        open_trunk(str(tmp_path / "none.onnx"))
    with pytest.raises(ConfigError, match=r"no backbone is named 'renset'; known: .*tactile_resnet18"):
        open_trunk("renset")


class Resnet18:
    """A backbone that can give any tap, and usually gives layer1 and layer2."""

    def trunk(self, taps: tuple[str, ...] = ("layer1", "layer2")) -> bytes:
        return build_trunk(random_state("resnet18"), "resnet18", taps)


def test_a_backbone_is_asked_for_the_taps_it_does_not_give_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """The usual trunk is kept where it has the taps, so that parts with the same depth share one file. A backbone may
    know what its weights are, which goes into the manifest."""
    assert str(open_trunk("tactile_resnet18").facts["weights"]).startswith("trained on simulated presses")
    monkeypatch.setattr(registry, "names", lambda kind: ["mine"])
    monkeypatch.setattr(registry, "backbone", lambda name: Resnet18())
    usual = open_trunk("mine")
    assert usual.facts == {}
    assert open_trunk("mine", ("layer2",)).sha256 == usual.sha256
    deep = open_trunk("mine", ("layer2.0",))
    assert output_names(deep.graph) == ["layer2.0"]
    assert deep.facts["taps"] == ["layer2.0"]
