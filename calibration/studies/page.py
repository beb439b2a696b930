"""What a report is made of: a page of markdown and its figures."""

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["Page"]


@dataclass(frozen=True)
class Page:
    """One study's page: markdown that names its figures, and the figures by file name, SVG text."""

    markdown: str
    figures: Mapping[str, str] = field(default_factory=dict)
