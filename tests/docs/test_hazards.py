"""The list of numerical hazards names every file that holds one, and every number."""

import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "hazards"
ROWS = [
    line for line in (FOLDER / "README.md").read_text(encoding="utf-8").splitlines() if line.startswith("| H")
]


def test_every_file_is_listed_under_its_number() -> None:
    """Each `test_hNN_*.py` is in a row of hazard NN, and no row names a missing file."""
    listed = {
        (int(number), file)
        for row in ROWS
        for number in re.findall(r"^\| H(\d+):", row)
        for file in re.findall(r"`(test_h\w+\.py)`", row)
    }
    assert listed == {(int(path.name[6:8]), path.name) for path in FOLDER.glob("test_h*.py")}


def test_the_numbers_run_from_1_to_20() -> None:
    """H1 to H20, each with a test."""
    assert {int(number) for row in ROWS for number in re.findall(r"^\| H(\d+):", row)} == set(range(1, 21))
