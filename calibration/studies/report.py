"""Pages made from rows alone. Each study has a page, a function in PAGES."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.studies.page import Page
from calibration.studies.rows import rows_of_studies
from edge.core.errors import ConfigError, StoreError

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["PAGES", "write_report"]


def _good_fraction(rows: "pd.DataFrame") -> Page:
    from calibration.studies.good_fraction_page import page

    return page(rows)


def _cross_position(rows: "pd.DataFrame") -> Page:
    from calibration.studies.cross_position_page import page

    return page(rows)


def _resolution(rows: "pd.DataFrame") -> Page:
    from calibration.studies.resolution_page import page

    return page(rows)


def _bad_presses(rows: "pd.DataFrame") -> Page:
    from calibration.studies.bad_presses_page import page

    return page(rows)


def _paper(rows: "pd.DataFrame") -> Page:
    from calibration.studies.paper_page import page

    return page(rows)


def _recommend(rows: "pd.DataFrame") -> Page:
    from calibration.studies.recommend_page import page

    return page(rows)


def _time(rows: "pd.DataFrame") -> Page:
    from calibration.studies.time_page import page

    return page(rows)


COMPARED_WITH_THE_PAPER = ("good-fraction", "cross-position", "resolution")
"""The studies that repeat a validation of the paper."""

PAGES: dict[str, Callable[["pd.DataFrame"], Page]] = {
    "good-fraction": _good_fraction,
    "cross-position": _cross_position,
    "resolution": _resolution,
    "bad-presses": _bad_presses,
}
"""A study's page from its rows, by the study's name. Modules are imported at use."""


def write_report(rows: Path, output: Path, say: Callable[[str], None] = lambda sentence: None) -> list[Path]:
    """Write the page of every study that has rows, a comparison with the paper, the recommendations, and the time.

    Figures are next to the pages. rows: a file, or the folder of one. say: called with a sentence about a line that was
    dropped. Errors: ConfigError for a file without rows,
    StoreError for a full disk.
    """
    import pandas as pd

    every = pd.DataFrame(rows_of_studies(rows, say))
    known = [name for name in PAGES if name in set(every["study"])]
    if not known:
        raise ConfigError(
            f"'{rows}' has rows of {', '.join(sorted(set(every['study'])))}, which have no page here"
        )
    written = [
        _write(output, name, PAGES[name](every[every["study"] == name].dropna(axis=1, how="all")))
        for name in known
    ]
    repeated = every[every["study"].isin(COMPARED_WITH_THE_PAPER)]
    if not repeated.empty:
        written.append(_write(output, "paper", _paper(repeated)))
    written.append(_write(output, "recommend", _recommend(every)))
    return [*written, _write(output, "time", _time(every))]


def _write(output: Path, name: str, page: Page) -> Path:
    target = output / f"{name}.md"
    try:
        output.mkdir(parents=True, exist_ok=True)
        for file, draw in page.figures.items():
            (output / file).write_text(draw(), encoding="utf-8")
        target.write_text(page.markdown, encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"the report cannot be written to '{output}': {error.strerror}; choose another folder"
        ) from error
    return target
