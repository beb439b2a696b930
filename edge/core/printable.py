"""Text from elsewhere, for a terminal."""

__all__ = ["printable"]


def printable(text: object) -> str:
    """The text with every control character as its escape, so that a terminal shows it and does not obey it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))
