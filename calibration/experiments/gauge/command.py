"""`gelgate lab msa`: plan a gauge study, run it on a station, and report it."""

import secrets
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from calibration.experiments.gauge.live import run_study
from calibration.experiments.gauge.plan import Piece, make_plan, material, read_plan
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.config import load_config
from edge.core.errors import ConfigError, DatasetError
from edge.core.suggest import suggestion
from edge.extras import needs
from edge.store.study_presses import StudyPress, read_study, studies

__all__ = ["msa"]

msa = typer.Typer(help="Measurement systems analysis: a gauge study.", no_args_is_help=True)


@msa.command()
def plan(
    output: Annotated[Path, typer.Option("--output", "-o", help="The plan's file.")] = Path("study.json"),
    pieces: Annotated[int, typer.Option(help="Number of pieces, named P1, P2 and so on.")] = 10,
    operators: Annotated[int, typer.Option(help="Number of operators, named A, B and so on.")] = 3,
    repeats: Annotated[int, typer.Option(help="Presses of each piece by each operator.")] = 3,
    piece: Annotated[
        list[str] | None, typer.Option(help="The name of a piece, instead of --pieces; repeatable.")
    ] = None,
    operator: Annotated[
        list[str] | None, typer.Option(help="The name of an operator, instead of --operators; repeatable.")
    ] = None,
    bad: Annotated[
        list[str] | None, typer.Option(help="A piece that must fail; the others must pass. Repeatable.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the random order; by default a new one.")] = None,
) -> None:
    """Write who presses what, in a random order.

    With --bad it is known of every piece whether it is good, and the report compares verdicts with that."""
    if output.exists():
        raise ConfigError(f"{output} exists, and may be in use; name another file")
    names = piece or [f"P{number}" for number in range(1, pieces + 1)]
    who = operator or [chr(ord("A") + n % 26) + (str(n // 26) if n >= 26 else "") for n in range(operators)]
    for name in bad or ():
        if name not in names:
            raise ConfigError(f"--bad: no piece is named '{name}'; {suggestion(name, names)}")
    known = [
        Piece(name=name, known=None if bad is None else "fail" if name in bad else "pass") for name in names
    ]
    made = make_plan(known, who, repeats, secrets.randbits(32) if seed is None else seed, time.time_ns())
    output.write_text(made.text(), encoding="utf-8")
    typer.echo(
        f"{len(made.order)} presses in {output}, seed {made.seed}; run them with `gelgate lab msa run {output}`"
    )


@msa.command()
def run(
    plan: Annotated[Path, typer.Argument(help="The plan's file.")],
    config: ConfigOption = CONFIG,
) -> None:
    """Press the plan on a station, step by step.

    It takes the place of `gelgate run` meanwhile; the station's sensor may be a recording. Presses count on the gel,
    and are not published as results. r and Enter repeats the last press, s and Enter skips the next one. After Ctrl-C
    the same command goes on."""
    try:
        text = plan.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"plan {plan} cannot be read: {error}; `gelgate lab msa plan` makes one") from error
    left = run_study(read_plan(text, plan), load_config(config), typer.echo)
    if left:
        typer.echo(f"{left} presses are left; the same command goes on with them")
    else:
        typer.echo(f"the study is complete; report it with `gelgate lab msa report {plan} -c {config}`")


@msa.command()
def report(
    study: Annotated[
        str | None, typer.Argument(help="The plan's file, or the study's id; by default the newest study.")
    ] = None,
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write this .md or .csv file.")
    ] = None,
) -> None:
    """Report a study from the rows of the database.

    Gauge R&R of the score, agreement of the verdicts, and drift. The gateway may run meanwhile."""
    needs("studies", "gelgate lab msa report")
    from calibration.experiments.gauge.report import FORMATS, report_sections

    if output is not None and output.suffix.lower() not in FORMATS:
        raise ConfigError(f"the ending of {output} names no format; known are {', '.join(FORMATS)}")
    text, rows = _read_stored(database_path(config, database), study)
    sections = report_sections(material(read_plan(text, "in the database"), rows))
    write = FORMATS[".md" if output is None else output.suffix.lower()]
    made = write("Measurement systems analysis", sections)
    if output is None:
        typer.echo(made, nl=False)
    else:
        output.write_text(made, encoding="utf-8")
        typer.echo(f"the report of {len(rows)} presses is in {output}")


def _read_stored(database: Path, study: str | None) -> tuple[str, Sequence[StudyPress]]:
    """The plan and the presses. Errors: DatasetError where there is no such study, or no press; StoreError."""
    known = studies(database)
    if not known:
        raise DatasetError(f"database {database} has no gauge study; `gelgate lab msa run` makes one")
    chosen = known[-1][0] if study is None else study
    if study is not None and Path(study).is_file():
        chosen = read_plan(Path(study).read_text(encoding="utf-8"), study).study_id
    stored_study = read_study(database, chosen)
    if stored_study is None:
        raise DatasetError(
            f"database {database} has no study '{chosen}'; it has {', '.join(plugin for plugin, _, _ in known)}"
        )
    return stored_study
