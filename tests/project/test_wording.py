"""Docstrings, comments, messages and pages use common words."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

ROOMS = [
    *("edge", "plugins", "calibration", "export", "examples", "docs", "firmware_notes"),
    *("README.md", "CHANGELOG.md"),
    *(
        f"tests/{room}"
        for room in ("core/contact", "detectors", "fitting", "gateway", "hazards", "messaging", "tradeoff")
    ),
    *(f"tests/{room}" for room in ("acquisition", "detectability", "studies", "export")),
]

PLAINER = {
    "told": "reported, distinguished",
    "beside": "next to",
    "anew": "again",
    "so many": "this many",
    "mended": "corrected",
    "dear": "expensive",
    "nobody": "no one, or the passive",
    "whoever": "the subject itself",
}
"""A word that readers with English as a second language may not know in its sense here, and what to write."""


def texts(room: str) -> Iterator[Path]:
    path = ROOT / room
    yield from [path] if path.is_file() else sorted((*path.rglob("*.py"), *path.rglob("*.md")))


@pytest.mark.parametrize("room", ROOMS)
def test_words_are_common(room: str) -> None:
    """The word and the line where it is."""
    files = list(texts(room))
    assert files
    found = [
        f"{file.relative_to(ROOT)}:{number}: '{word}', write {PLAINER[word]}"
        for file in files
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1)
        for word in PLAINER
        if re.search(rf"\b{word}\b", line, re.IGNORECASE)
    ]

    assert found == []
