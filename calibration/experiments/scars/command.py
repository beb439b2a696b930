"""The verb `evaluate-scars`."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["evaluate_scars"]

# Seeds of the placings in each set; development and judgement share no press.
SEEDS = {"development": 1_000_000, "judgement": 6_000_000}


def evaluate_scars(
    which: Annotated[
        str, typer.Option("--set", help="development, or judgement: gels apart.")
    ] = "development",
    gels: Annotated[int, typer.Option(help="Gels of each placing.", min=1, max=1000)] = 4,
    placing: Annotated[
        list[str] | None, typer.Option(help="These placings only, such as 'thread in a fixture'.")
    ] = None,
    flattened: Annotated[
        float, typer.Option(help="Share of a scar that contact presses flat.", min=0, max=0.9)
    ] = 0.0,
    json: Annotated[Path | None, typer.Option(help="Write every alarm to this JSON file.")] = None,
) -> None:
    """How scars of the gel and damage are distinguished.

    On simulated worn gels with scratches, dents, hairs and worn coat: six ways to place parts, with a bundle each.
    Prints the cause that each alarm was given, by what raised it, with exact binomial limits."""
    from calibration.experiments.harness.rows import check_json, write_json
    from calibration.experiments.harness.study import require_known
    from calibration.experiments.scars.runs import Run, Station, table
    from calibration.experiments.scars.worn_gel import PLACINGS
    from calibration.progress import progress

    require_known("set", [which], SEEDS)
    require_known("placing", placing or (), PLACINGS)
    check_json(json)
    chosen = [(k, one) for k, one in enumerate(PLACINGS.values()) if not placing or one.name in placing]
    runs: list[Run] = []
    with progress("gels", gels * len(chosen)) as advance:
        for number, one in chosen:
            station = Station.fit(one, SEEDS[which] + number)
            for gel in range(gels):
                runs.append(Run(station, gel, flattened).play())
                advance(len(runs))
    alarms = [alarm for run in runs for alarm in run.alarms]
    typer.echo(table(alarms, sum(run.presses for run in runs)))
    write_json(json, alarms)
