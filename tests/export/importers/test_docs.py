"""docs/export.md, trained detectors: every command runs as it is written, up to the verdicts."""

import pickle
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from anomalib_files import ROOT, SMALL
from command_line import gelgate, ran
from station import press_recording
from toy_trunk import toy_trunk

from edge.core.errors import ConfigError
from edge.model.bundle import Bundle
from export import import_padim, import_spade

PAGE = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
PRESSES = 5


def section(title: str) -> str:
    """The text of one subsection."""
    return PAGE.partition(f"\n### {title}\n")[2].partition("\n### ")[0].partition("\n## ")[0]


def commands(title: str) -> list[list[str]]:
    blocks = re.findall(r"```console\n(.*?)```", section(title), re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines()]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the page names."""
    home = tmp_path_factory.mktemp("files")
    press_recording(home / "presses", PRESSES)
    press_recording(home / "recording", PRESSES, dented=[2], seed=1)
    shutil.copy(SMALL / "padim.ckpt", home / "padim.ckpt")
    trunk = toy_trunk({"layer1": (4, 8), "layer2": (4, 16), "layer3": (4, 32)})
    (home / "trunk.onnx").write_bytes(trunk)
    rng = np.random.default_rng(0)
    cov = np.einsum("pdn,pen->dep", rng.random((784, 3, 9)), rng.random((784, 3, 9)))
    cov = (cov + cov.transpose(1, 0, 2)) / 2 + 20 * np.eye(3)[:, :, None]
    (home / "train_bracket.pkl").write_bytes(pickle.dumps([rng.random((3, 784)), cov]))
    return home


@pytest.fixture
def folder(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with copies of them."""
    monkeypatch.chdir(shutil.copytree(files, tmp_path, dirs_exist_ok=True))
    return tmp_path


def test_from_anomalib_to_verdicts(folder: Path) -> None:
    """Every press of the virtual sensor is judged; a list in memory is in the place of the page's broker."""
    *before, run = commands("I trained this in anomalib")
    for line in before:
        done = ran(*line)
        if line[:2] == ["export", "detect"]:
            assert "PaDiM of anomalib" in done
    (toml,) = re.findall(r"```toml\n(.*?)```", section("I trained this in anomalib"), re.DOTALL)
    config = toml.partition("[[sinks]]")[0] + '[[sinks]]\nplugin = "memory"\n'
    (folder / "station.toml").write_text(config)

    assert f"{PRESSES} presses: " in ran(*run)


def test_from_the_papers_pickles_to_a_bundle(folder: Path) -> None:
    """Mean and covariance of the port, whose channels are drawn again."""
    for line in commands("I have the paper's pickles"):
        done = ran(*line)
        if line[:2] == ["export", "detect"]:
            assert "PaDiM's mean and covariance" in done
        if line[:2] == ["export", "import"]:
            assert "random.seed(1024)" in done


def test_from_python(folder: Path) -> None:
    """A notebook ends with a bundle, whose manifest has licence, source and losses; another method's is refused."""
    given = {"part": "bracket", "licence": "own", "profile": "cropped_lr"}
    with pytest.raises(ConfigError, match=r"padim\.ckpt is PaDiM of anomalib .* use import_padim"):
        import_spade("padim.ckpt", "presses", "bracket.zip", **given)
    assert not (folder / "bracket.zip").exists()
    made = import_padim("padim.ckpt", "presses", "bracket.zip", **given)

    manifest = Bundle.load(made.path).manifest
    assert manifest.facts["licence"] == "own"
    assert manifest.facts["imported"]["source"].startswith("PaDiM of anomalib")
    assert "rank correlation 1.0000" in made.losses.words()


def test_a_licence_that_is_not_stated_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before a file is opened, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    Path("padim.ckpt").touch()
    Path("presses").mkdir()
    words = ("export", "import", "padim.ckpt", "presses", "-o", "bracket.zip", "--part", "bracket")
    for given in ((), ("--licence", ""), ("--licence", " ")):
        refused = gelgate(*words, *given).sentence()
        assert "the licence of padim.ckpt and of its weights is not stated" in refused
    assert not Path("bracket.zip").exists()


def test_nothing_is_half_written(folder: Path) -> None:
    """A refusal after the file was read leaves the folder as it was."""
    before = sorted(folder.iterdir())

    done = gelgate(
        "export", "import", "train_bracket.pkl", "presses", "-o", "b.zip", "--part", "x", "--licence", "own",
        "--backbone", "trunk.onnx", "--profile", "cropped_lr", "--region", "0,0,128x128",
    )  # fmt: skip

    assert "'mean' has 784 places, the taps give 256" in done.sentence()
    assert sorted(folder.iterdir()) == before
