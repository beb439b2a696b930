"""The page about bundles names everything that a bundle holds."""

from pathlib import Path
from typing import get_args

from edge.core.detector import Packing
from edge.model.manifest import Manifest

PAGE = (Path(__file__).parents[2] / "docs" / "bundle.md").read_text(encoding="utf-8")


def test_every_field_of_the_manifest_is_explained() -> None:
    assert [name for name in Manifest.model_fields if f"`{name}`" not in PAGE] == []


def test_every_packing_is_explained() -> None:
    assert [name for name in get_args(Packing) if f"`{name}`" not in PAGE] == []
