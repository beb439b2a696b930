"""`gelgate bundle inspect` and `gelgate bundle verify`: what a bundle is, and whether it is sound."""

import json
from pathlib import Path

import pytest
import tiny
from typer.testing import CliRunner

from edge import cli
from edge.core.errors import BundleCorrupt
from edge.model.bundle import GoldenFrame
from edge.model.bundle_writer import write_bundle
from edge.model.manifest import Manifest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    _, files = tiny.tiny_files(tiny.tiny_bank(packing="int8"))
    return write_bundle(tmp_path / "bolt", files)


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli.build(), [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_inspect_tells_what_is_in_it(folder: Path) -> None:
    """Part, method, profile, region, trunk, bank with both sizes, threshold and origin, one per line."""
    code, text = run("bundle", "inspect", folder)
    assert code == 0
    for said in (
        "bolt, position crest",
        "tiny, mode corrected",
        "picture 48x40",
        "8,4,32x32",
        "float32 3x4x4, 192 bytes, stored as int8 in",
        "0.05 (given by hand)",
        "unknown: frames of another sensor are not refused",
        "2026-01-01",
    ):
        assert said in text


def test_inspect_as_json_is_the_manifest(folder: Path) -> None:
    """`--json` gives every field, ready for another program."""
    code, text = run("bundle", "inspect", folder, "--json")
    assert code == 0
    assert Manifest.model_validate_json(text) == tiny.tiny_files(tiny.tiny_bank(packing="int8"))[0]
    assert json.loads(text)["threshold"]["value"] == 0.05


def test_verify_accepts_a_sound_bundle(folder: Path) -> None:
    """It says what was checked."""
    code, text = run("bundle", "verify", folder)
    assert code == 0
    assert "every SHA-256 is correct" in text
    assert "is sound" in text


def test_verify_fails_with_exit_code_5(folder: Path) -> None:
    """One changed byte: a sentence, and the documented exit code."""
    (folder / "head.onnx").write_bytes((folder / "head.onnx").read_bytes()[:-1] + b"?")
    code, text = run("bundle", "verify", folder)
    assert code == 5
    assert "head.onnx has SHA-256" in text


def test_verify_scores_the_golden_frames(tmp_path: Path) -> None:
    """A bundle with correct hashes and different scores of its frames is not sound."""
    peaks = tuple((9.0,) * 8 for _ in range(8))
    _, files = tiny.tiny_files(golden=[GoldenFrame(tiny.presses(1)[0], "a press", 9.0, peaks)])
    code, text = run("bundle", "verify", write_bundle(tmp_path / "bolt.zip", files))
    assert code == 5
    assert "golden frame 0 (a press) scores" in text


def test_inspect_of_nothing_is_a_bundle_error(tmp_path: Path) -> None:
    """Exit code 3 through the command line's table."""
    with pytest.raises(BundleCorrupt, match="no bundle at"):
        run("bundle", "inspect", tmp_path / "none")
