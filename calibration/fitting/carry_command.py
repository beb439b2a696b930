"""`gelgate bundle carry`: a bundle and a few presses on a new gel in, the bundle for that gel out."""

import datetime
from dataclasses import dataclass
from pathlib import Path

from calibration.fitting.command import refuse_existing, summarise
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
from edge.cli.arguments import add_argument, flatten

__all__ = ["carry"]


@dataclass(frozen=True)
class CarryArguments:
    """What the command line says."""

    output: Output
    bundle: Path = add_argument(..., "The bundle of the old gel.")
    sources: list[Path] = add_argument(
        ..., "4 to 8 presses of sound parts on the new gel, as for `fit`.", metavar="SOURCE..."
    )
    no_contact: NoContact = None
    gel: GelId = None
    resize: Resize = False
    pattern: Pattern = None
    leave_out: LeaveOut = None
    threads: Threads = 2
    overwrite: Overwrite = False
    revision: Revision = None


@flatten
def carry(given: CarryArguments) -> None:
    """Carry a bundle over to a new gel of its sensor.

    Bank and graphs stay; limit, free gel, colours and golden frames are those of the new gel. The promise of the limit
    is that of the few presses: `gelgate gel prove` shows more, and a new fit promises more.
    """
    from calibration.fitting.carry import CarryConfig, carry_bundle
    from calibration.fitting.presses.nominal_presses import read_presses
    from edge.model.bundle import Bundle

    refuse_existing(given.output, given.overwrite)
    old = Bundle.load(given.bundle)
    presses = read_presses(
        given.sources,
        old.profile,
        old.region,
        no_contact=given.no_contact,
        resize=given.resize,
        pattern=given.pattern,
        leave_out=given.leave_out,
    )
    config = CarryConfig(datetime.date.today().isoformat(), given.gel, given.revision, given.threads)
    fitted = carry_bundle(old, presses, config)
    fitted.write(given.output, overwrite=given.overwrite)
    summarise(fitted, given.output)
