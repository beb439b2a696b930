"""docs/msa.md: its example is what the program prints, and its numbers are the published ones."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def printed() -> ModuleType:
    spec = importlib.util.spec_from_file_location("msa_example", DOCS / "msa_example.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_example_is_what_the_program_prints(printed: ModuleType) -> None:
    """`make docs` writes it."""
    assert (DOCS / "msa.md").read_text(encoding="utf-8") == printed.page()


@pytest.mark.parametrize("published", ["0.19993", "0.22684", "0.30237", "1.0423", "94.6471"])
def test_the_example_has_the_published_numbers(printed: ModuleType, published: str) -> None:
    """To the places that are printed."""
    assert published in printed.example()
