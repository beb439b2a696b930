"""The verb `report`: pages and figures made from rows alone."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.experiments.harness.figures import svg
from calibration.experiments.harness.page import Page
from calibration.experiments.harness.rows import rows_of_studies
from calibration.experiments.studies import (
    bad_presses_study,
    cross_position_study,
    good_fraction_study,
    paper_page,
    recommend,
    resolution_study,
)
from calibration.folders import make_folder, write_atomically
from edge.core.errors import ConfigError
from edge.extras import needs

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["PAGES", "report", "write_report"]


COMPARED_WITH_THE_PAPER = ("good-fraction", "cross-position", "resolution")
"""The studies that repeat a validation of the paper."""

PAGES: dict[str, Callable[["pd.DataFrame"], Page]] = {
    study.STUDY: study.page
    for study in (good_fraction_study, cross_position_study, resolution_study, bad_presses_study)
}
"""A study's page from its rows, by the study's name."""


def report(
    rows: Annotated[Path, typer.Argument(help="The rows.jsonl of `gelgate lab study`, or its folder.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the pages and figures.")],
) -> None:
    """Make a study's page and figures from its rows."""
    needs("studies", "report")
    for page in write_report(rows, output, partial(typer.echo, err=True)):
        typer.echo(f"page: {page}")


def write_report(rows: Path, output: Path, say: Callable[[str], None] = lambda sentence: None) -> list[Path]:
    """Write the page of every study that has rows, a comparison with the paper, the recommendations, and the time.

    Figures are next to the pages. rows: a file, or the folder of one. say: called with a sentence about a line that was
    dropped. Errors: ConfigError for a file without rows, GelgateError where the disk refuses.
    """
    import pandas as pd

    every = pd.DataFrame(rows_of_studies(rows, say))
    known = [name for name in PAGES if name in set(every["study"])]
    if not known:
        raise ConfigError(
            f"'{rows}' has rows of {', '.join(sorted(set(every['study'])))}, which have no page here"
        )
    make_folder(output)
    written = [
        _write(output, name, PAGES[name](every[every["study"] == name].dropna(axis=1, how="all")))
        for name in known
    ]
    repeated = every[every["study"].isin(COMPARED_WITH_THE_PAPER)]
    if not repeated.empty:
        written.append(_write(output, "paper", paper_page.page(repeated)))
    written.append(_write(output, "recommend", recommend.page(every)))
    return written


def _write(output: Path, name: str, page: Page) -> Path:
    target = output / f"{name}.md"
    for file, draw in page.figures.items():
        write_atomically(output / file, svg(draw()).encode())
    write_atomically(target, page.text.encode())
    return target
