"""The peers of another program: what is refused before anything is measured."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from calibration.experiments.tradeoff.peers import CORESET, learn, require_models
from edge.core.errors import ConfigError


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('raise RuntimeError("operator torchvision::nms does not exist")', "torchvision::nms does not exist"),
        ('raise OSError("libcudart.so.13: cannot open shared object file")', "libcudart.so.13"),
        ('raise ImportError("cannot import name X")', "cannot import name X"),
    ],
)
def test_a_torchvision_of_another_build_is_a_sentence(
    line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its import raises; the sentence says what to install."""
    (tmp_path / "anomalib").mkdir()
    (tmp_path / "anomalib" / "__init__.py").write_text(f"{line}\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "anomalib"]:
        monkeypatch.delitem(sys.modules, name)

    with pytest.raises(ConfigError, match="--peers cannot import anomalib") as refusal:
        require_models()
    assert said in str(refusal.value)
    assert "an environment of its own (docs/studies.md), with torch and torchvision of the same build" in str(
        refusal.value
    )


class Recorded:
    """A model that notes whether gradients are kept in each of its steps."""

    def __init__(self) -> None:
        self.steps: list[tuple[str, bool]] = []
        self.feature_extractor = SimpleNamespace(eval=lambda: self.note("extractor"))

    def note(self, step: str) -> None:
        import torch

        self.steps.append((step, torch.is_grad_enabled()))

    def __getattr__(self, step: str) -> Any:
        return lambda *given: self.note(f"{step}{given}")

    def __call__(self, planes: str) -> None:
        self.note(planes)


@pytest.mark.parametrize(
    ("method", "last"), [("padim", "fit()"), ("patchcore", f"subsample_embedding({CORESET},)")]
)
@pytest.mark.train
def test_a_peer_learns_without_gradients(method: str, last: str) -> None:
    """A selection that keeps them keeps every difference of two patches."""
    model = Recorded()
    learn(method, model, ["first", "second"])

    assert model.steps[2:5] == [("first", False), ("second", False), (last, False)]
    assert model.steps[5] == ("eval()", True)


@pytest.mark.train
@pytest.mark.skipif(sys.platform != "linux", reason="SKIPPED, NOT TESTED: needs Linux")
def test_large_blocks_are_mapped_before_a_peer_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the selection of PatchCore takes 18 GB; a C library without the setting is left as it is."""
    asked: list[tuple[int, int]] = []
    library = SimpleNamespace(mallopt=lambda *given: asked.append(given))
    monkeypatch.setattr("ctypes.CDLL", lambda name: library)
    learn("patchcore", Recorded(), [])
    del library.mallopt
    learn("patchcore", Recorded(), [])

    assert asked == [(-3, 1 << 20)]
