"""`gelgate station overview` as a user sets up a station."""

from pathlib import Path

import cv2
from command_line import gelgate

STATION = """
version = 1
[device]
plugin = "recorded"
options = { recording = "presses" }
[inspection]
bundle = "bundle"
[[sinks]]
plugin = "memory"
"""
OVERVIEW = """
[overview]
plugin = "virtual_overview"
codes = ["qr"]
part_pattern = "(?P<part>.*);.*"
empty = "empty.jpg"
options = { parts = ["%s"] }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "gelgate.toml"
    path.write_text(text)
    return path


def test_the_empty_station_is_saved_and_then_compared_with(tmp_path: Path) -> None:
    """First without a part, into the file that [overview] names; then with one: its code, and how much differs."""
    saved = gelgate(
        "station",
        "overview",
        "-c",
        written(tmp_path, STATION + OVERVIEW % ""),
        "--save",
        tmp_path / "empty.jpg",
    )
    seen = gelgate("station", "overview", "-c", written(tmp_path, STATION + OVERVIEW % "PZ0;42"))

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
    done = gelgate("station", "overview", "-c", written(tmp_path, STATION))

    assert done.code != 0
    assert "has no [overview]; docs/operations.md shows one" in done.err
