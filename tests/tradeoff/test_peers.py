"""The peers of another program: what is refused before anything is measured."""

import sys
from pathlib import Path

import pytest

from calibration.tradeoff.peers import require_models
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
    assert "install torch and torchvision of the same build" in str(refusal.value)
