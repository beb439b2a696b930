"""`gelgate lab detectability`: the smallest damage that a bundle finds, in mm, at every place of the contact."""

from datetime import date
from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.experiments.detectability.study import Plan, Row, Settings, plan, run
from calibration.experiments.harness.rows import Rows
from calibration.experiments.harness.study import require_known
from calibration.fitting.command import refuse_existing
from calibration.fitting.damage.damage import KINDS
from calibration.fitting.options import NoContact, Part, Pattern, Position, Resize, Seed, Threads
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.presses.sources import find_sources
from calibration.folders import make_folder, write_atomically
from calibration.progress import Stages, progress
from edge.extras import needs
from edge.model.bundle import Bundle
from edge.model.detectability import detectability_lines

__all__ = ["detectability"]

TRIALS, RESULT, TABLE, MAP = "trials.jsonl", "detectability.json", "detectability.csv", "detectability.png"


def detectability(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="The bundle: a folder or a .zip.")],
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="PRESSES...", help="Nominal presses: recordings, datasets, folders or pictures."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The folder for trials, table, JSON and map.")
    ],
    part: Part = None,
    position: Position = None,
    kind: Annotated[
        list[str] | None, typer.Option(help="dent, bump or scratch; may be repeated. Default: all three.")
    ] = None,
    presses: Annotated[int, typer.Option(min=4, help="How many presses are edited, at most.")] = 8,
    spacing: Annotated[float, typer.Option(min=0.2, help="Between places, in mm.")] = 1.5,
    no_contact: NoContact = None,
    resize: Resize = False,
    pattern: Pattern = None,
    write: Annotated[bool, typer.Option("--write", help="Put the card into the bundle.")] = False,
    seed: Seed = 0,
    threads: Threads = 2,
) -> None:
    """Measure the smallest damage found, by place.

    Dents, bumps and scratches of known depth are rendered into nominal presses that the judging bank has not learnt.
    The result is the probability of detection: a90/95 in mm as a map, a table and a card. An interrupted run goes on
    where it ended.
    """
    needs("studies", "gelgate lab detectability")
    from calibration.experiments.detectability.figure import draw_map
    from calibration.experiments.detectability.results import card, results, table, write_card

    require_known("damage", kind or (), KINDS)
    settings = Settings(tuple(dict.fromkeys(kind or KINDS)), presses, spacing, seed, threads)
    loaded = Bundle.load(bundle)
    if write:
        refuse_existing(bundle, overwrite=True)
    own, sensor = loaded.manifest, loaded.profile
    press_sources = find_sources(sources, part or own.part, position or own.position, sensor.size)
    how: dict[str, Any] = {"no_contact": no_contact or (), "resize": resize, "pattern": pattern}
    shown = read_presses(press_sources.paths, sensor, loaded.region, specimens=press_sources.specimens, **how)
    make_folder(output)
    planned, rows = _measure(loaded, shown, settings, Rows(output / TRIALS, _warn))
    curves = results(planned, rows)
    made = card(planned, curves, date.today().isoformat())
    write_atomically(output / TABLE, (table(made) + "\n").encode())
    write_atomically(output / RESULT, (made.model_dump_json(indent=1) + "\n").encode())
    write_atomically(output / MAP, draw_map(planned, curves))
    for line in detectability_lines(made):
        typer.echo(line)
    typer.echo(f"written to {output}: {MAP}, {TABLE}, {RESULT}, {TRIALS}")
    if write:
        was_signed = write_card(bundle, made)
        typer.echo(f"the card is in {bundle}, whose id has changed; `gelgate bundle inspect` prints it")
        if was_signed:
            _warn(f"the signature of {bundle} was of the bundle without a card and is removed: sign it again")


def _measure(
    bundle: Bundle, presses: NominalPresses, settings: Settings, rows: Rows
) -> tuple[Plan, list[Row]]:
    with Stages() as report:
        planned = plan(bundle, presses, settings, lambda fraction: report("banks", fraction))
    typer.echo(_describe_plan(planned))
    if presses.estimated:
        _warn(f"the free gel is {presses.estimated}; give a picture of it with --no-contact for exact sizes")
    done = {row["key"]: row for row in rows.read()}
    with rows.hold(), progress("trials", planned.total) as advance:
        return planned, run(planned, done, rows.append, advance)


def _describe_plan(planned: Plan) -> str:
    """Say what is going to be measured, and which presses are not used."""
    judged = {
        "presses apart": "presses that the bundle has not learnt, judged by it",
        "folds": "learnt presses, each judged by a bank fitted without it",
        "third party's graph": "presses, judged by the third party's graph",
    }[planned.by]
    sentence = (
        f"{len(planned.places)} places of {planned.settings.spacing_mm:g} mm, {len(planned.presses)} {judged}"
    )
    if planned.false_alarms:
        sentence += f"; left out, because they fail without damage: {', '.join(planned.false_alarms)}"
    if planned.refused:
        sentence += f"; left out, because their colours are of another sensor: {', '.join(planned.refused)}"
    return sentence


def _warn(sentence: str) -> None:
    typer.echo(f"warning: {sentence}", err=True)
