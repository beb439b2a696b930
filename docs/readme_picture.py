"""Draws the animation at the head of README.md from a run of the demo: `make readme-picture`.

What the sensor saw, frame by frame, the score map of the newest press, its verdict, and the count of the gel: of the
recording, of the published pictures, and of the database. It plays at half speed.
"""

import sqlite3
import sys
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.imaging.decode import decode
from edge.model.bundle import Bundle
from edge.recording.format import Recording

PRESSES: Final = 5
FREE: Final = 6  # frames of the free gel before the first
HELD: Final = 2  # frames that a press rests before its verdict
SECONDS: Final = 10
PANEL: Final = 300  # pixels
GAP: Final = 8
QUALITY: Final = 90  # of WebP: below one megabyte
INK, SOFT, PAPER = (25, 25, 25), (110, 110, 110), 250
COLOURS: Final = {"pass": (50, 120, 20), "fail": (30, 25, 185)}  # BGR, as on the page

# Where the score map stands in a published picture.
HEADER, LEGEND = 40, 112

U8 = NDArray[np.uint8]


def score_map(picture: U8) -> U8:
    """Cut the score map from the picture of a press."""
    side = (picture.shape[1] - GAP - LEGEND) // 2
    return picture[HEADER : HEADER + side, side + GAP : 2 * side + GAP]


def draw(press: U8, heat: U8 | None, verdict: str, ratio: float, gel: str, share: float) -> U8:
    """One frame of the animation: uint8 (height, width, 3) BGR. press, heat: of the same region. share: of the gel."""
    width, top, size = 2 * PANEL + GAP, 44 + PANEL + 30, (PANEL, PANEL)
    made = np.full((top + 28, width, 3), PAPER, np.uint8)

    def write(text: str, x: int, y: int, scale: float, colour: tuple[int, int, int] = INK) -> None:
        cv2.putText(made, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, scale, colour, 1, cv2.LINE_AA)

    made[44 : 44 + PANEL, :PANEL] = cv2.resize(press, size, interpolation=cv2.INTER_CUBIC)
    made[44 : 44 + PANEL, PANEL + GAP :] = (
        0 if heat is None else cv2.resize(heat, size, interpolation=cv2.INTER_AREA)
    )
    if verdict:
        cv2.rectangle(made, (0, 0), (110, 38), COLOURS[verdict], cv2.FILLED)
        write(verdict.upper(), 16, 28, 0.9, (255, 255, 255))
        write(f"{ratio:.2f} x threshold", 124, 27, 0.6)
    write("press", 4, top - 14, 0.45, SOFT)
    write("score map", PANEL + GAP + 4, top - 14, 0.45, SOFT)
    cv2.rectangle(made, (0, top), (width - 1, top + 22), (213, 213, 213), cv2.FILLED)
    cv2.rectangle(made, (0, top), (round(width * share), top + 22), COLOURS["pass"], cv2.FILLED)
    write(gel, 12, top + 16, 0.5)
    return made


def main(demo: Path, output: Path) -> None:
    """Read the demo's folder and write the animation."""
    manifest = Bundle.load(demo / "bundle").manifest
    seen = manifest.profile
    region = manifest.region
    recorded = list(Recording.open(next((demo / "recordings").glob("seed-*/test"))))
    with sqlite3.connect(f"file:{demo / 'gelgate.db'}?mode=ro", uri=True) as store:
        presses = store.execute(
            "SELECT verdict, score / threshold, gel_presses FROM presses ORDER BY number"
        ).fetchall()
        ((limit,),) = store.execute("SELECT limit_presses FROM gels")
    pictures = sorted((demo / "heatmaps").iterdir())
    labels = [one.label or {} for one in recorded]
    first = next(n for n, label in enumerate(labels) if label["press"] == 0) - FREE
    last = next(n for n, label in enumerate(labels) if label["press"] == PRESSES)
    frames: list[U8] = []
    heat, verdict, ratio, gel = None, "", 0.0, 0
    for number in range(first, last):
        before = labels[number - HELD : number]
        if labels[number]["phase"] != "hold":
            heat, verdict = None, ""
        elif all(label["phase"] == "hold" for label in before):
            press = labels[number]["press"]
            heat, (verdict, ratio, gel) = score_map(cv2.imread(str(pictures[press]))), presses[press]
        rgb = decode(recorded[number].frame, seen)
        counted = f"gel: {gel} of {limit} presses"
        frames.append(draw(region.crop(rgb)[..., ::-1], heat, verdict, ratio, counted, gel / limit))
    animation = cv2.Animation()
    animation.frames = frames
    animation.durations = np.full(len(frames), round(1000 * SECONDS / len(frames)), np.int32)
    cv2.imwriteanimation(str(output), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    print(f"{output}: {len(frames)} frames, {output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
