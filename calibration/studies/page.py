"""What a report is made of: a page of markdown and its figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

__all__ = ["Page"]


@dataclass(frozen=True)
class Page:
    """One study's page: markdown that names its figures, and what draws each as SVG text, by file name."""

    markdown: str
    figures: Mapping[str, Callable[[], str]] = field(default_factory=dict)
