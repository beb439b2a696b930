"""Texts and numbers as a terminal or a file shows them."""

import json
import math

__all__ = ["printable", "score_texts", "toml_string", "write_count", "write_most"]


def printable(text: object) -> str:
    """The text with every control character as its escape, so that a terminal shows it and does not obey it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def toml_string(text: str) -> str:
    """The text as a TOML file has it: a JSON string, but for DEL, which TOML wants escaped."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def write_count(n: int, noun: str) -> str:
    """Write how many there are: `1 press`, `2 presses`, `1 nominal frame`."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}{'es' if noun.endswith('s') else 's'}"


def score_texts(score: float, threshold: float, digits: int = 4, form: str = "f") -> tuple[str, str]:
    """Write both with as many digits as they need to differ, so that a fail never reads as its threshold."""
    for more in range(digits, 18):
        texts = f"{score:.{more}{form}}", f"{threshold:.{more}{form}}"
        if score == threshold or texts[0] != texts[1]:
            break
    return texts


def write_most(rate: float) -> str:
    """Write an upper limit of a rate in two digits, upwards: `18 %` for 0.1746."""
    step = 10.0 ** (math.floor(math.log10(100 * rate)) - 1) if rate else 1.0
    return f"{math.ceil(100 * rate / step - 1e-9) * step:.3g} %"
