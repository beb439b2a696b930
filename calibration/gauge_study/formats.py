"""A report as text, Markdown, HTML or CSV."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from html import escape
from textwrap import wrap
from typing import Final

from calibration.gauge_study.report import Section, Table

__all__ = ["FORMATS", "csv_tables", "html_page", "markdown", "plain_text"]

# Sentences of the text form are broken at this width; tables are as wide as they are.
WIDTH: Final = 100


def plain_text(title: str, sections: Sequence[Section]) -> str:
    """For a terminal: columns in line."""
    parts = [title, "=" * len(title)]
    for section in sections:
        parts += ["", section.title, "-" * len(section.title)]
        parts += [line for sentence in section.sentences for line in wrap(sentence, WIDTH)]
        parts += _aligned(section.table) if section.table else []
    return "\n".join(parts) + "\n"


def markdown(title: str, sections: Sequence[Section]) -> str:
    """Tables as in GitHub's Markdown."""
    parts = [f"# {title}"]
    for section in sections:
        parts += [
            "",
            f"## {section.title}",
            *(text for sentence in section.sentences for text in ("", sentence)),
        ]
        if section.table:
            rows = [section.table.head, ("---",) * len(section.table.head), *section.table.rows]
            parts += [
                "",
                *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows),
            ]
    return "\n".join(parts) + "\n"


def html_page(title: str, sections: Sequence[Section]) -> str:
    """One file without others, which also prints well."""
    body = "\n".join(map(_html_section, sections))
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        "<style>body{font:14px/1.4 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}table{border-collapse:"
        "collapse;margin:1em 0}td,th{border:1px solid #999;padding:.25em .6em;text-align:left}th{background:#eee}"
        "</style>"
        f"</head><body>\n<h1>{escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def csv_tables(title: str, sections: Sequence[Section]) -> str:
    """Every table with its section's title in the first column."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["report", title])
    for section in sections:
        for sentence in section.sentences:
            writer.writerow([section.title, sentence])
        if section.table:
            writer.writerows([section.title, *row] for row in (section.table.head, *section.table.rows))
    return out.getvalue()


FORMATS: Final[Mapping[str, Callable[[str, Sequence[Section]], str]]] = {
    ".txt": plain_text,
    ".md": markdown,
    ".html": html_page,
    ".csv": csv_tables,
}
"""Ending of a file's name to its form."""


def _aligned(table: Table) -> list[str]:
    rows = [table.head, *table.rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(table.head))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return ["", lines[0], "  ".join("-" * width for width in widths), *lines[1:]]


def _html_section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>"]
    parts += [f"<p>{escape(sentence)}</p>" for sentence in section.sentences]
    if section.table:
        head = "".join(f"<th>{escape(cell)}</th>" for cell in section.table.head)
        rows = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
            for row in section.table.rows
        )
        parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>")
    return "\n".join(parts)
