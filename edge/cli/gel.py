"""`gelgate gel`: show the gel ledger, or record that a gel was replaced."""

import dataclasses
import getpass
import json
import time
from datetime import date
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.clock import local_day, local_time
from edge.config import load_config
from edge.config.tables import GelTable
from edge.core.errors import ConfigError, StoreError
from edge.core.gel_life import GelLabel, is_past
from edge.core.part_position import PartPosition
from edge.core.printable import printable, write_count
from edge.core.suggest import suggestion
from edge.messaging.publisher import PublisherLock
from edge.messaging.status_payloads import GelPayload
from edge.store import gel_ledger, gel_proofs
from edge.store.acts import Act
from edge.store.database import open_read_only, refuse_left_journal
from edge.store.gel_proofs import GelBundle
from edge.store.press_counts import PressCounts
from edge.store.press_store import GelRecord, Store

__all__ = ["gel", "user"]

gel = typer.Typer(help="Show the wear of gels, or record a replacement.", no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@gel.command()
def show(
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    serial: Annotated[str | None, typer.Option(help="This sensor only.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print every gel with its presses, limit and state.

    A mounted gel is marked with *."""
    with open_read_only(database_path(config, database), "reading the gel ledger") as connection:
        gels = gel_ledger.history(connection, serial, _gel_table(config, database).warn_fraction)
        used = gel_proofs.of_mounted(connection)
    if as_json:
        print(json.dumps([_plain(record) for record in gels], indent=2))
    elif not gels:
        print("no gel is known yet; the first press of a sensor adds its gel")
    else:
        print("\n".join(_line(record) for record in gels))
        for key, part, proof in used:
            if serial in (None, key.serial) and (text := proof.unproven(key.describe(part), key.gel_id)):
                print(printable(text))


@gel.command()
def replace(
    serial: Annotated[str | None, typer.Option(help="The sensor; needed if there are several.")] = None,
    gel_id: Annotated[str | None, typer.Option(help="The new gel's id; a number by default.")] = None,
    limit: Annotated[
        int | None,
        typer.Option(help="Presses allowed on it; the configured limit by default.", min=1, max=10_000_000),
    ] = None,
    note: Annotated[str, typer.Option(help="Why, or which batch.")] = "",
    gel_serial: Annotated[
        str | None, typer.Option(help="The new gel's own serial; one that was mounted before counts on.")
    ] = None,
    gel_type: Annotated[str | None, typer.Option(help="Its type, such as plain or markers.")] = None,
    use_by: Annotated[str | None, typer.Option(help="Its last day of use, YYYY-MM-DD.")] = None,
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
    as_json: AsJson = False,
) -> None:
    """Record that a new gel is mounted.

    Its count starts at 0, unless it was mounted before; the count of the old gel stays as history. What the package
    does not name is left out."""
    now_ns = time.time_ns()
    asked = {"serial": serial, "gel_id": gel_id, "limit_presses": limit, "note": note}
    try:
        label = GelLabel.of(gel_serial, gel_type, use_by)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    asked |= dataclasses.asdict(label)
    with _open(config, database) as store:
        on = _choose_serial(serial, sorted({record.serial for record in store.gels()}))
        _refuse_waiting(store.path, on)
        record = store.replace_gel(
            on,
            now_ns,
            gel_id,
            limit,
            note,
            lambda gel: [GelPayload.of(gel, now_ns).message()],
            Act(now_ns, f"{user()}, command line", "replace_gel", outcome="done", arguments=asked),
            label,
        )
    print(json.dumps(_plain(record), indent=2) if as_json else _line(record))
    for remark in record.list_remarks(local_day(now_ns)):
        typer.echo(printable(remark), err=True)


@gel.command()
def prove(
    serial: Annotated[str | None, typer.Option(help="The sensor; needed if there are several.")] = None,
    part: Annotated[str | None, typer.Option(help="Bundles of this part only.")] = None,
    config: ConfigOption = CONFIG,
    database: DatabaseOption = None,
) -> None:
    """Record that all presses on the mounted gel were of sound parts.

    A bundle that was made on another gel is then proven on this one, if they are enough with few alarms. Exit code 1
    where one is not."""
    with _open(config, database) as store:
        known = sorted({record.serial for record in store.gels()})
        on = _choose_serial(serial, known)
        used = store.read("reading where bundles are proven", gel_proofs.of_mounted)
        here = [(key, of, proof) for key, of, proof in used if key.serial == on and part in (None, of.part)]
        if part is not None and not here:
            parts = ", ".join(sorted({of.part for key, of, _ in used if key.serial == on})) or "none"
            raise ConfigError(f"no bundle of part '{part}' was used on the mounted gel; used were: {parts}")
        outcomes = [_prove(store, key, of) for key, of, proof in here if proof.proven is None]
    if not outcomes:
        print("every bundle that was used on the mounted gel is proven on it")
    if not all(outcomes):
        raise typer.Exit(1)


def _prove(store: Store, key: GelBundle, part: PartPosition) -> bool:
    """Prints the outcome, and writes it into the table of acts."""
    asked = {"serial": key.serial, "gel_id": key.gel_id, "bundle_id": key.bundle_id}
    act = partial(Act, time.time_ns(), f"{user()}, command line", "prove_gel", arguments=asked)
    try:
        proof = store.write("proving a bundle on a gel", partial(gel_proofs.prove, key=key, part=part))
    except ValueError as error:
        store.begin_act(act(outcome="refused", sentence=str(error)))
        print(printable(str(error)))
        return False
    store.begin_act(act(outcome="done"))
    print(printable(f"bundle {key.describe(part)} is proven on gel {key.gel_id}: {proof.sentence}"))
    return True


def user() -> str:
    """Who asks, for the table of acts."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        return "unnamed"


def _choose_serial(serial: str | None, known: list[str]) -> str:
    """Choose the sensor. An unknown one is refused: a mistyped one must not leave the worn gel in the ledger. Errors:
    ConfigError."""
    if serial is None and len(known) != 1:
        raise ConfigError(
            f"the sensor of the replaced gel is not clear; known are {', '.join(known) or 'none'}; name one with "
            "--serial"
        )
    if serial is not None and serial not in known:
        raise ConfigError(f"no gel of a sensor '{serial}' is in the ledger; {suggestion(serial, known)}")
    return serial or known[0]


def _refuse_waiting(database: Path, serial: str) -> None:
    """Refuse a new gel while a station has presses of the old one to record. Those of one that died are counted first.
    Errors: StoreError."""
    count = PressCounts(database).read().get(serial)
    if count is None or not count.uncounted:
        return
    try:
        PublisherLock(database).close()
    except StoreError as error:
        raise StoreError(
            f"the station that runs on database {database} has {write_count(count.uncounted, 'press')} of sensor "
            f"{serial} to record on the old gel; see its alarm `store`, and replace the gel after it"
        ) from error


def _open(config: Path, database: Path | None) -> Store:
    path, table = database_path(config, database), _gel_table(config, database)
    refuse_left_journal(path)
    return Store(path, limit_presses=table.limit_presses, warn_fraction=table.warn_fraction)


def _gel_table(config: Path, database: Path | None) -> GelTable:
    """The limits of gels; the usual ones where a database is named."""
    return GelTable() if database is not None else load_config(config).gel


def _line(record: GelRecord) -> str:
    mark = "*" if record.removed_ns is None else " "
    wear = "" if record.wear_index is None else f"  wear {record.wear_index:.2f}"
    last = "never used" if record.last_use_ns is None else f"last used {local_time(record.last_use_ns)}"
    past = " (past)" if is_past(record.use_by, date.today()) else ""
    package = {"serial": record.gel_serial, "type": record.gel_type, "use by": record.use_by}
    words = "".join(f"  {name} {text}" for name, text in package.items() if text is not None)
    note = f"  ({record.note})" if record.note else ""
    return printable(
        f"{mark} {record.gel_id}{words}{past}  sensor {record.serial}  {record.presses}/{record.limit_presses} presses"
        f"  {record.state}{wear}  mounted {local_time(record.installed_ns)}, {last}{note}"
    )


def _plain(record: GelRecord) -> dict[str, object]:
    return {**dataclasses.asdict(record), "state": str(record.state)}
