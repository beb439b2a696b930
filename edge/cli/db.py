"""`gelgate db`: check, back up and migrate the database of a station."""

from pathlib import Path
from typing import Annotated

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.core.errors import ConfigError, StoreError
from edge.core.printable import printable, write_count
from edge.messaging.publisher import PublisherLock
from edge.store.backup import back_up, backups_in, find_leftovers
from edge.store.backup import migrate as migrate_file
from edge.store.database import CHAINED_SINCE, SCHEMA_VERSION, refuse_left_journal
from edge.store.integrity import check_database
from edge.store.ledger_chain import Head

__all__ = ["db"]

db = typer.Typer(help="Check, back up or migrate the gateway's database.", no_args_is_help=True)


@db.command()
def check(
    database: DatabaseOption = None,
    config: ConfigOption = CONFIG,
    head: Annotated[
        str | None,
        typer.Option(
            help="A ledger_head that the station published earlier: it must still be in the ledger."
        ),
    ] = None,
) -> None:
    """Compare everything that the database says twice.

    The file's integrity, gel counts with presses and with their second record, the outbox with its totals, and the
    ledger with its chain of hashes. It reads only, and the gateway may run meanwhile."""
    path = database_path(config, database)
    refuse_left_journal(path)
    findings = check_database(path, None if head is None else _head(head))
    for finding in findings:
        typer.echo(printable(f"{'FAULT' if finding.is_fault else 'note '}  {finding.part}: {finding.text}"))
    faults = sum(finding.is_fault for finding in findings)
    if faults:
        raise StoreError(
            f"database {path} has {write_count(faults, 'fault')}, see above; stop the gateway, move the file away "
            "together with its -wal and -shm, and put the newest sound backup in its place"
        )
    typer.echo(f"ok     {path} is sound")


@db.command()
def backup(
    target: Annotated[Path, typer.Argument(help="A new file, or a folder: then the time is in the name.")],
    database: DatabaseOption = None,
    config: ConfigOption = CONFIG,
    keep: Annotated[
        int | None,
        typer.Option(
            help="Then keep this many backups in that folder: remove older ones, and what is left of killed ones.",
            min=1,
        ),
    ] = None,
) -> None:
    """Copy the database while the gateway runs.

    The copy is complete, checked, and needs no other file."""
    path = database_path(config, database)
    refuse_left_journal(path)
    if keep is not None and not target.is_dir():
        raise ConfigError(
            f"--keep removes older backups in a folder, and {target} is none; make it, or name another"
        )
    made = back_up(path, target)
    typer.echo(f"{made}: {made.stat().st_size:,} bytes")
    for old in (*backups_in(target, path)[:-keep], *find_leftovers(target, path)) if keep else ():
        old.unlink(missing_ok=True)  # by another backup just now
        typer.echo(f"{old}: removed")


@db.command()
def migrate(database: DatabaseOption = None, config: ConfigOption = CONFIG) -> None:
    """Bring an older database to this version, after a backup.

    The backup is next to the file. A start of the gateway does the same."""
    path = database_path(config, database)
    refuse_left_journal(path)
    lock = PublisherLock(path)  # an older gateway must not write meanwhile
    try:
        before, copy = migrate_file(path)
    finally:
        lock.close()
    if copy is None:
        typer.echo(f"{path} has version {before}; nothing to do")
    else:
        typer.echo(f"{path} migrated from version {before} to {SCHEMA_VERSION}; as it was: {copy}")
        if before < CHAINED_SINCE:
            typer.echo("its ledger is chained from here on; the presses and acts from before are not covered")


def _head(text: str) -> Head:
    """Read a head from the command line. Errors: ConfigError."""
    try:
        return Head.parse(text)
    except ValueError as error:
        raise ConfigError(f"--head: {error}") from error
