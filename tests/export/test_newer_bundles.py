"""A bundle that a newer program wrote is refused by name, by every verb and by the example, and nothing is written."""

import json
from pathlib import Path

import numpy as np
import pytest
import tiny
from command_line import gelgate, refuse_by_example

from edge.model.bundle_writer import write_bundle
from edge.model.manifest import SCHEMA_VERSION


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    """A bundle of the next schema, and stages next to it."""
    folder = tmp_path / "bolt"
    write_bundle(folder, tiny.tiny_files()[1])
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "schema_version": SCHEMA_VERSION + 1}))
    np.savez(tmp_path / "stages.npz", frames=tiny.presses(1))
    return folder


@pytest.mark.parametrize(
    "verb",
    [
        ("merge", "{bundle}", "-o", "{out}.onnx"),
        ("parity", "{bundle}", "{stages}", "--report", "{out}"),
        ("precision", "{bundle}", "{presses}", "-o", "{out}"),
    ],
)
def test_verbs_refuse_it(newer: Path, verb: tuple[str, ...]) -> None:
    names = {name: newer.parent / name for name in ("out", "presses")}
    names |= {"bundle": newer, "stages": newer.parent / "stages.npz"}
    names["presses"].mkdir()
    before = sorted(newer.parent.iterdir())

    refused = gelgate("export", *(word.format(**names) for word in verb)).sentence()
    assert f"schema {SCHEMA_VERSION + 1}, this program reads up to" in refused
    assert sorted(newer.parent.iterdir()) == before


def test_the_example_refuses_it(newer: Path) -> None:
    """Also a program that has nothing of gelgate."""
    assert f"manifest schema {SCHEMA_VERSION + 1}, this program reads 1" in refuse_by_example(newer)
