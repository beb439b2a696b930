"""A picture in the terminal: the bytes of the protocol, and no byte where the terminal does not say that it draws."""

import base64
import io
import re

import cv2
import numpy as np
import pytest

from edge.pictures.terminal import draw_in_terminal

PICTURE = np.random.default_rng(0).integers(0, 255, (300, 1000, 3), np.uint8)


class Terminal(io.StringIO):
    """What a terminal gets."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_that_draws_gets_a_png_in_pieces() -> None:
    """Each piece but the last announces another; together they are the picture, 800 pixels wide."""
    out = Terminal()
    assert draw_in_terminal(PICTURE, out, {"TERM": "xterm-kitty"})

    pieces = re.findall(r"\x1b_G([^;]*);([^\x1b]*)\x1b\\", out.getvalue())
    assert out.getvalue() == "".join(f"\x1b_G{keys};{data}\x1b\\" for keys, data in pieces) + "\n"
    assert pieces[0][0] == "f=100,a=T,q=2,m=1"
    assert {keys for keys, _ in pieces[1:-1]} == {"q=2,m=1"}
    assert pieces[-1][0] == "q=2,m=0"
    assert max(len(data) for _, data in pieces) <= 4096
    png = np.frombuffer(base64.b64decode("".join(data for _, data in pieces)), np.uint8)
    assert cv2.imdecode(png, cv2.IMREAD_COLOR).shape == (240, 800, 3)


@pytest.mark.parametrize(
    ("out", "environment"),
    [
        (io.StringIO(), {"TERM": "xterm-kitty"}),  # a file or a pipe
        (Terminal(), {}),
        (Terminal(), {"TERM": "xterm-256color"}),
        (Terminal(), {"TERM": "tmux-256color", "TERM_PROGRAM": "WezTerm"}),
    ],
)
def test_nothing_is_written_elsewhere(out: io.StringIO, environment: dict[str, str]) -> None:
    """A terminal that does not know the protocol would print thousands of letters."""
    assert not draw_in_terminal(PICTURE, out, environment)
    assert out.getvalue() == ""
