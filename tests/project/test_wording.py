"""The rooms' docstrings, comments, messages and pages use common words."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# Rooms that have been through the pass for plain English; the other rooms follow.
ROOMS = [
    *(f"calibration/{room}" for room in ("simulator", "training", "benchmark", "metrics")),
    *("plugins/devices/uvc", "plugins/devices/v4l2", "plugins/devices/virtual", "plugins/backbones"),
    *("plugins/detectors", "docs/detectors.md", "tests/detectors", "tests/hazards"),
    *("edge/core/imaging", "edge/model", "edge/recording", "firmware_notes", "docs/decisions"),
    *("edge/cli", "edge/store", "edge/pictures", "plugins/sinks", "plugins/conformance", "export"),
    *(
        "calibration/dataset",
        "calibration/evaluate",
        "calibration/tradeoff",
        "tests/tradeoff",
        "docs/tradeoff.md",
        "calibration/demo.py",
        "calibration/progress.py",
    ),
    *(
        "edge/config.py",
        "edge/registry.py",
        "plugins/devices/recorded.py",
        "docs/plugins.md",
        "docs/architecture.md",
    ),
    *("CHANGELOG.md", "docs/cli.md", "docs/config.md"),
    *("edge/core/contact", "tests/core/contact", "docs/contact.md"),
    *(
        "calibration/fitting",
        "tests/fitting",
        "edge/gateway",
        "edge/messaging",
        "tests/gateway",
        "tests/messaging",
        "docs/mqtt.md",
    ),
    *(f"edge/core/{module}.py" for module in ("detector", "ports", "plugins", "verdict", "sink_context")),
    *("README.md", "docs/glossary.md", "docs/bundle.md", "docs/sensors.md", "docs/simulator.md"),
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
