"""The licence of weights that a user brings: it must be stated before anything is exported."""

from edge.core.errors import ConfigError

__all__ = ["MOST_CHARACTERS", "stated_licence"]

MOST_CHARACTERS = 200


def stated_licence(text: str | None, what: str, usual: str | None = None) -> str:
    """The stated licence without surrounding spaces. what: the file or weights; usual: what its authors state.

    Errors: ConfigError where it is not stated, or is not one short line.
    """
    licence = (text or "").strip()
    if not licence:
        hint = f"its authors state {usual}; " if usual else ""
        raise ConfigError(
            f"the licence of {what} is not stated; {hint}look it up and pass --licence, such as --licence Apache-2.0, "
            "or --licence own for weights that you trained"
        )
    if len(licence) > MOST_CHARACTERS or not licence.isprintable():
        raise ConfigError(
            f"the licence of {what} has {len(licence)} characters or is not one line; give its short name, such as "
            "CC-BY-NC-4.0"
        )
    return licence
