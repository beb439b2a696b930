"""Recordings of a gel that is scarred between two presses: the mark is in every picture from then on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from station import FPS, HEADER, Motion, gel, jpeg

from edge.recording.format import RecordingWriter

MARK = (136, 112, 8)
"""Left, top and side of a small mark under the part: one cell of the tiny detector."""

_LEVELS = 70.0


def scarred_recording(
    folder: Path,
    presses: int,
    *,
    marks: Mapping[int, Sequence[tuple[int, int, int]]],
    dented: Sequence[int] = (),
    motion: Motion | None = None,
    levels: float = _LEVELS,
    wiped: int | None = None,
    fps: float = FPS,
    on_part: Callable[[NDArray[np.uint8], int], NDArray[np.uint8]] = lambda frame, press: frame,
) -> Path:
    """Presses as of `press_recording`. marks: left, top and side of the marks that appear before press n, and how
    strong. wiped: the press before which all are gone. on_part: changes the frames of press n while it is pressed."""
    motion = motion or Motion(idle=20)
    rng = np.random.default_rng(5)
    shown: list[tuple[int, int, int]] = []
    number = 0
    with RecordingWriter(folder, replace(HEADER, nominal_fps=fps)) as writer:
        for press in range(-1, presses):
            depths = [0.0] * motion.free if press < 0 else [0.5, *[1.0] * motion.hold, 0.3]
            after = 0 if press < 0 else motion.idle
            for step, depth in enumerate([*depths, *[0.0] * after]):
                if step == len(depths):
                    if press + 1 == wiped:
                        shown.clear()
                    shown += marks.get(press + 1, ())
                frame = gel(rng, depth, press in dented)
                frame = _marked(on_part(frame, press) if depth else frame, shown, levels)
                writer.add(jpeg(frame), round(number * 1e9 / fps), {"press": press if depth else None})
                number += 1
    return folder


def _marked(
    frame: NDArray[np.uint8], marks: Sequence[tuple[int, int, int]], levels: float
) -> NDArray[np.uint8]:
    light = frame.astype(np.float32)
    for left, top, side in marks:
        light[top : top + side, left : left + side] -= levels
    return np.clip(light, 0, 255).astype(np.uint8)
