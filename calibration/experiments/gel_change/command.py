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
    import json as json_format
    from dataclasses import asdict

    from calibration.evaluate.report import write_atomically
    from calibration.experiments.gel_change.study import METHODS, Figures, measure_part, table
    from calibration.progress import progress
    from edge.core.errors import ConfigError
    from edge.core.suggest import suggestion

    if which not in SEEDS:
        raise ConfigError(f"no set is named '{which}'; {suggestion(which, SEEDS)}")
    for name in method or ():
        if name not in METHODS:
            raise ConfigError(f"no detector of this study is named '{name}'; {suggestion(name, METHODS)}")
    if json is not None and (json.is_dir() or not json.parent.is_dir()):
        raise ConfigError(f"'{json}' cannot be written; name a file in an existing folder")
    figures: list[Figures] = []
    with progress("parts", parts) as advance:
        for number in range(parts):
            figures += measure_part(SEEDS[which], number, method or METHODS, is_other_unit=other_unit)
            advance(number + 1)
            if json is not None:
                write_atomically(json, json_format.dumps([asdict(one) for one in figures], indent=1).encode())
    typer.echo(table(figures))
