"""A sentence for the person at a station."""

from collections.abc import Iterable
from typing import NewType

__all__ = ["Sentence", "join_sentences"]

Sentence = NewType("Sentence", str)
"""English, made of one literal. The operator page has it in its languages: its catalogues hold it as a pattern, names
and numbers in braces, and it is found by what stands between them. A sentence may be a value of another one, and
several are joined by `; `."""


def join_sentences(sentences: Iterable[str]) -> Sentence | None:
    """Join several to one; None for none."""
    return Sentence("; ".join(sentences)) or None
