"""The verb `recommend`: which method to take, from the rows of studies."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.experiments.harness.rows import rows_of_studies
from calibration.experiments.harness.study import require_known
from calibration.experiments.studies.recommend import NEEDS, write_answers
from calibration.experiments.studies.recommend import recommend as recommend_methods
from edge.core.errors import ConfigError
from edge.extras import needs

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["recommend"]


def recommend(
    rows: Annotated[Path, typer.Argument(help="The rows.jsonl of `gelgate lab study`, or its folder.")],
    need: Annotated[
        list[str] | None,
        typer.Option(
            help="few-presses, localisation, cross-position, high-resolution, no-fixture, bad-presses or least-time; "
            "may be given several times. Default: all.",
            show_default=False,
        ),
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(help="Rows of this mode; needed where they have several.", show_default=False),
    ] = None,
    backbone: Annotated[
        str | None, typer.Option(help="Rows of this backbone, likewise.", show_default=False)
    ] = None,
    split: Annotated[
        str | None, typer.Option(help="Rows of this split, likewise.", show_default=False)
    ] = None,
) -> None:
    """Say which method to take for a need, from rows alone.

    Where the rows do not decide, it says so, and which command would."""
    needs("studies", "recommend")
    import pandas as pd

    require_known("need", need or (), NEEDS)
    chosen = pd.DataFrame(rows_of_studies(rows, partial(typer.echo, err=True)))
    for column, wanted in (("mode", mode), ("backbone", backbone), ("split", split)):
        chosen = _choose(chosen, column, wanted)
    first = chosen.iloc[0]
    typer.echo(f"rows of {first['backbone']}, {first['mode']} mode, split by {first['split']}")
    typer.echo(f"\n{write_answers(recommend_methods(chosen, need or ()))}", nl=False)


def _choose(rows: "pd.DataFrame", column: str, wanted: str | None) -> "pd.DataFrame":
    """Return the rows with one value in a column. Errors: ConfigError where several are possible, or none has it."""
    found = sorted(set(rows[column].astype(str)))
    if wanted is None and len(found) > 1:
        raise ConfigError(
            f"the rows have several values of {column}: {', '.join(found)}; choose one with --{column}"
        )
    if wanted is not None and wanted not in found:
        raise ConfigError(f"no row has the {column} '{wanted}'; the rows have {', '.join(found)}")
    return rows[rows[column].astype(str) == (wanted or found[0])]
