"""The verb `evaluate-new-gel`."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["evaluate_new_gel"]

# Seeds of parts, gels and presses; development and judgement share none.
SEEDS = {"development": 51_000, "judgement": 53_000}


def evaluate_new_gel(
    which: Annotated[
        str, typer.Option("--set", help="development, or judgement: parts and gels apart.")
    ] = "development",
    parts: Annotated[int, typer.Option(help="Parts, each on two gels.", min=1, max=1000)] = 4,
    method: Annotated[list[str] | None, typer.Option(help="These detectors only.")] = None,
    other_unit: Annotated[
        bool, typer.Option("--other-unit", help="Another unit instead of another gel: the hard limit.")
    ] = False,
    json: Annotated[Path | None, typer.Option(help="Write every figure to this JSON file.")] = None,
) -> None:
    """What a bundle loses on a new gel, and how to keep it.

    On simulated parts, each pressed on two gels of one sensor. Prints for each detector and each way to keep a bundle
    AU-PRO, image AUROC, and false alarms and detection at the limit."""
    from calibration.experiments.gel_change.study import METHODS, Row, measure_part, table
    from calibration.experiments.harness.rows import check_json, write_json
    from calibration.experiments.harness.study import require_known
    from calibration.progress import progress

    require_known("set", [which], SEEDS)
    require_known("detector of this study", method or (), METHODS)
    check_json(json)
    rows: list[Row] = []
    with progress("parts", parts) as advance:
        for number in range(parts):
            rows += measure_part(SEEDS[which], number, method or METHODS, is_other_unit=other_unit)
            advance(number + 1)
            write_json(json, rows)
    typer.echo(table(rows))
