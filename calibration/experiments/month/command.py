"""`gelgate lab month`: what goes wrong in a month of presses, with a bundle that stays and with one that learns."""

from pathlib import Path
from typing import Annotated

import typer

from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.study import require_known
from calibration.experiments.month.page import write_page
from calibration.experiments.month.plan import DAYS, FULL, SETS, Month
from calibration.experiments.month.run import ARMS, run_month
from calibration.progress import progress
from edge.extras import needs

__all__ = ["month"]

ROWS, PAGE, FIGURE = "month.jsonl", "month.md", "month.svg"


def month(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The folder for rows, page and figure, and for the work.")
    ],
    which: Annotated[
        str, typer.Option("--set", help="development, or judgement: parts apart.")
    ] = "development",
    parts: Annotated[int, typer.Option(help="Parts, each with a month of its own.", min=1, max=100)] = 1,
    first: Annotated[
        int, typer.Option(help="The first part: rows of parts that ran apart may stand in one file.", min=0)
    ] = 0,
    presses: Annotated[int, typer.Option(help="Presses of a month.", min=DAYS, max=100_000)] = FULL,
    page: Annotated[
        Path | None, typer.Option(help="Write the page to this file, its figure into `images` beside it.")
    ] = None,
) -> None:
    """A month on the line: dust, wear, drift, a person.

    Random parts are pressed for 30 days at two stations: one keeps its bundle, one learns from a person who answers
    up to ten questions a day. Rows for each day, a page with curves. An interrupted run goes on with the day that it
    was in.
    """
    needs("studies", "gelgate lab month")
    require_known("set", [which], SETS)
    months = [Month(which, part, presses) for part in range(first, first + parts)]
    rows, done = Rows(output / ROWS, lambda sentence: typer.echo(f"warning: {sentence}", err=True)), 0
    with rows.hold(), progress("days", parts * len(ARMS) * DAYS) as show:

        def advance() -> None:
            nonlocal done
            done += 1
            show(done)

        for plan in months:
            run_month(plan, output, rows, advance)
    wanted = [
        row
        for row in rows.read()
        if (row["set"], row["month_presses"]) == (which, presses) and first <= row["part"] < first + parts
    ]
    span = f"--first {first} --parts {parts}" if first else f"--parts {parts}"
    command = f"gelgate lab month --set {which} {span} --presses {presses}"
    target = page or output / PAGE
    write_page(wanted, target, (target.parent / "images" if page else output) / FIGURE, command)
    typer.echo(f"{len(wanted)} days in {rows.path}; the page is {target}")
