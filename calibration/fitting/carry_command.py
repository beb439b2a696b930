"""`gelgate bundle carry`: a bundle and a few presses on a new gel in, the bundle for that gel out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.fitting.options import (
    GelId,
    LeaveOut,
    NoContact,
    Output,
    Overwrite,
    Pattern,
    Resize,
    Revision,
    Threads,
)

if TYPE_CHECKING:
    from calibration.fitting.presses.nominal_presses import NominalPresses
    from edge.model.bundle import Bundle

__all__ = ["carry"]


def carry(
    bundle: Annotated[Path, typer.Argument(help="The bundle of the old gel.")],
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...", help="4 to 8 presses of sound parts on the new gel, as for `fit`."
        ),
    ],
    output: Output,
    no_contact: NoContact = None,
    gel: GelId = None,
    resize: Resize = False,
    pattern: Pattern = None,
    leave_out: LeaveOut = None,
    threads: Threads = 2,
    overwrite: Overwrite = False,
    revision: Revision = None,
) -> None:
    """Carry a bundle over to a new gel of its sensor.

    Bank and graphs stay; limit, free gel, colours and golden frames are those of the new gel. The promise of the limit
    is that of the few presses: `gelgate gel prove` shows more, and a new fit promises more.
    """
    import datetime

    from calibration.fitting.carry import CarryConfig, carried
    from calibration.fitting.command import refuse_existing, summary, write
    from edge.model.bundle import Bundle

    refuse_existing(output, overwrite)
    old = Bundle.load(bundle)
    presses = _presses(old, sources, no_contact or [], resize, pattern, leave_out or [])
    config = CarryConfig(datetime.date.today().isoformat(), gel, revision, threads)
    fitted = carried(old, presses, config)
    write(fitted, output, overwrite)
    summary(fitted, output)


def _presses(
    bundle: "Bundle",
    sources: list[Path],
    no_contact: list[Path],
    resize: bool,
    pattern: str | None,
    leave_out: list[str],
) -> "NominalPresses":
    from calibration.fitting.presses.nominal_presses import read_presses

    return read_presses(
        sources,
        bundle.profile,
        bundle.region,
        no_contact=no_contact,
        resize=resize,
        pattern=pattern,
        leave_out=leave_out,
    )
