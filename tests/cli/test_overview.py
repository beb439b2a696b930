"""`gelgate station overview` as a user sets up a station."""

from pathlib import Path

import cv2
from command_line import Outcome, gelgate
from station import station_config

OVERVIEW = """
[overview]
plugin = "virtual_overview"
codes = ["qr"]
part_pattern = "(?P<part>.*);.*"
empty = "empty.jpg"
options = { parts = ["%s"] }
"""


def overview(folder: Path, tables: str, *more: object) -> Outcome:
    config = station_config(folder, folder / "presses", folder / "bundle", tables=tables)
    return gelgate("station", "overview", "-c", config, *more)


def test_the_empty_station_is_saved_and_then_compared_with(tmp_path: Path) -> None:
    """First without a part, into the file that [overview] names; then with one: its code, and how much differs."""
    saved = overview(tmp_path, OVERVIEW % "", "--save", tmp_path / "empty.jpg")
    seen = overview(tmp_path, OVERVIEW % "PZ0;42")

    assert saved.out.splitlines() == [
        f"saved {tmp_path / 'empty.jpg'}",
        "640x480; empty station: no picture of it",
        "no qr code is read",
    ]
    assert cv2.imread(str(tmp_path / "empty.jpg")).shape == (480, 640, 3)
    size, code = seen.out.splitlines()
    assert size.startswith("640x480; empty station: ")
    assert float(size.split()[-2].removesuffix("%")) > 10
    assert code == "qr 'PZ0;42': part PZ0"


def test_a_station_without_an_overview_camera_is_refused(tmp_path: Path) -> None:
    """With the page that shows how to have one."""
    done = overview(tmp_path, "")

    assert done.code != 0
    assert "has no [overview]; docs/operations.md shows one" in done.err
