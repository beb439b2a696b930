"""docs/glossary.md defines the words that the other pages use."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [
    ROOT / "README.md",
    *(page for page in (ROOT / "docs").rglob("*.md") if page != GLOSSARY),
]
DEFINITIONS = dict(
    re.findall(r"^\| ([^|]+) \| ([A-Z][^|]+) \|$", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
)
TERMS = [
    *("bundle", "trunk", "head", "tap", "bank", "press", "settled frame", "piece (specimen)", "position"),
    *("no-contact reference (free gel)", "threshold", "tolerance", "fold", "false-alarm rate", "score map"),
    *("gel wear", "sink", "outbox", "tile", "region", "profile"),
]


def test_every_term_is_defined_in_alphabetical_order() -> None:
    """A reader finds each word, and finds it where a dictionary has it."""
    assert list(DEFINITIONS) == sorted(TERMS)


@pytest.mark.parametrize("term", TERMS)
def test_a_term_is_used_by_another_page(term: str) -> None:
    """Both words where a term has two, such as piece and specimen."""
    text = " ".join(page.read_text(encoding="utf-8") for page in PAGES).lower()

    for word in re.sub(r"[()]", ",", term).split(","):
        assert not word.strip() or re.search(rf"\b{' '.join(word.split())}s?\b", " ".join(text.split()))
