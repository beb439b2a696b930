"""The verb `report`: a page and its figures from rows alone."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from calibration.experiments.studies.report import write_report
from edge.extras import needs

__all__ = ["report"]


def report(
    rows: Annotated[Path, typer.Argument(help="The rows.jsonl of `gelgate lab study`, or its folder.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pages and figures.")],
) -> None:
    """Make a study's page and figures from its rows."""
    needs("studies", "report")
    for page in write_report(rows, output, partial(typer.echo, err=True)):
        typer.echo(f"page: {page}")
