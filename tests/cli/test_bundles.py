"""`gelgate bundle inspect` and `gelgate bundle verify`: what a bundle is, and whether it is sound."""

import json
from pathlib import Path

import pytest
import tiny
from command_line import ran

from edge.model.bundle_writer import write_bundle
from edge.model.manifest import Manifest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    _, files = tiny.tiny_files(tiny.tiny_bank(packing="int8"))
    return write_bundle(tmp_path / "bolt", files)


def test_inspect_tells_what_is_in_it(folder: Path) -> None:
    """Part, method, profile, region, trunk, bank with both sizes, threshold and origin, one per line."""
    text = ran("bundle", "inspect", folder)
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
    text = ran("bundle", "inspect", folder, "--json")
    assert Manifest.model_validate_json(text) == tiny.tiny_files(tiny.tiny_bank(packing="int8"))[0]
    assert json.loads(text)["threshold"]["value"] == 0.05


def test_verify_accepts_a_sound_bundle(folder: Path) -> None:
    """It says what was checked; what it refuses is in `test_refused_work.py`."""
    text = ran("bundle", "verify", folder)
    assert "every SHA-256 is correct" in text
    assert "is sound" in text
