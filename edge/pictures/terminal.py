"""A picture in the terminal, where it says by its environment that it draws pictures.

Ref: the terminal graphics protocol of kitty, sw.kovidgoyal.net/kitty/graphics-protocol. Sixel is left out: a terminal
tells that it knows sixel only in answer to a question, and waiting for one hangs where nothing answers.
"""

import base64
from collections.abc import Iterator, Mapping
from typing import Final, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.pictures.image_file import encode

__all__ = ["draw_in_terminal"]

# By TERM and TERM_PROGRAM; a multiplexer between them has another TERM, and passes no picture on.
_TERMS: Final = ("xterm-kitty", "xterm-ghostty")
_PROGRAMS: Final = ("WezTerm", "ghostty")

_WIDEST: Final = 800  # pixels
_CHUNK: Final = 4096  # characters, the most that the protocol allows


def draw_in_terminal(picture: NDArray[np.uint8], out: TextIO, environment: Mapping[str, str]) -> bool:
    """Draw a picture, uint8 (h, w, 3) RGB, if `out` is a terminal that can; return whether it was drawn."""
    term, program = environment.get("TERM", ""), environment.get("TERM_PROGRAM", "")
    if not out.isatty() or not (term in _TERMS or (program in _PROGRAMS and term.startswith("xterm"))):
        return False
    h, w = picture.shape[:2]
    size = (min(w, _WIDEST), round(h * min(w, _WIDEST) / w))
    small = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    out.writelines(_chunks(base64.b64encode(encode(small, {})).decode()))
    out.write("\n")
    return True


def _chunks(data: str) -> Iterator[str]:
    """Write a PNG (f=100) that is shown at once (a=T), in pieces; m=1 says that another follows."""
    for start in range(0, len(data), _CHUNK):
        more = int(start + _CHUNK < len(data))
        first = "f=100,a=T," if start == 0 else ""
        yield f"\x1b_G{first}q=2,m={more};{data[start : start + _CHUNK]}\x1b\\"
