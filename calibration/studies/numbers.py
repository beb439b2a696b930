"""Lists of numbers on the command line."""

from edge.core.errors import ConfigError

__all__ = ["parsed_counts", "parsed_fractions"]

NONE = "none"


def parsed_fractions(text: str) -> tuple[float, ...]:
    """Shares in (0, 1] from percentages: `5:100:5`, `5,10,20`, or `none`. Errors: ConfigError."""
    if text.strip() == NONE:
        return ()
    try:
        percent = _range(text) if ":" in text else [float(word) for word in text.split(",")]
    except ValueError:
        percent = []
    if not percent or not all(0 < value <= 100 for value in percent):
        raise ConfigError(
            f"--fractions are percentages above 0 up to 100, such as 5:100:5 or 5,10,20, found '{text}'"
        )
    return tuple(sorted({round(value / 100, 6) for value in percent}))


def _range(text: str) -> list[float]:
    first, last, step = (float(word) for word in text.split(":"))
    if step <= 0 or first > last:
        raise ValueError(text)
    return [first + k * step for k in range(int((last - first) / step + 1e-9) + 1)]


def parsed_counts(text: str, option: str) -> tuple[int, ...]:
    """Whole numbers of at least 1: `1,2,4`, or `none`. Errors: ConfigError."""
    if text.strip() == NONE:
        return ()
    try:
        counts = sorted({int(word) for word in text.split(",")})
    except ValueError:
        counts = []
    if not counts or counts[0] < 1:
        raise ConfigError(f"{option} are whole numbers of at least 1, such as 1,2,4, found '{text}'")
    return tuple(counts)
