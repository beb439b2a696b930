"""`gelgate gel`: the ledger on the command line."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from edge.cli.gel import replace, show
from edge.core.errors import ConfigError
from edge.store.outbox import Outbox
from edge.store.press_store import PressRecord, Store
from edge.store.ulid import new_ulid

T0 = 1_780_000_000 * 10**9


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """A ledger of one sensor with one press."""
    path = tmp_path / "gelgate.db"
    with Store(path) as store:
        store.record_press(PressRecord(new_ulid(T0), T0, "2BNN4ZE7", "bolt", "pass"), lambda gel: [])
    return path


def test_show_prints_each_gel_on_a_line(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The mounted one is marked with *."""
    show(database=database)

    out = capsys.readouterr().out
    assert out.startswith("* 2BNN4ZE7-1  sensor 2BNN4ZE7  1/1000 presses  good  mounted 2026-")


def test_replace_records_the_act_and_publishes_it(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The only sensor need not be named; history stays; the new gel waits in the outbox, retained."""
    replace(database=database, limit=500, note="torn")
    capsys.readouterr()
    show(database=database, as_json=True)

    old, new = json.loads(capsys.readouterr().out)
    assert (old["presses"], old["removed_ns"] is None) == (1, False)
    assert (new["gel_id"], new["presses"], new["limit_presses"], new["note"]) == (
        "2BNN4ZE7-2",
        0,
        500,
        "torn",
    )
    with Outbox(database) as outbox:
        (row,) = outbox.pending("mqtt")
    assert (row.message.topic, row.message.retain) == ("gel", True)


def test_with_two_sensors_one_must_be_named(database: Path) -> None:
    """The sentence lists them."""
    with Store(database) as store:
        store.gel("OTHER123", T0)

    with pytest.raises(ConfigError, match="known are 2BNN4ZE7, OTHER123; name one with --serial"):
        replace(database=database)


def test_a_database_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    """A mistyped path does not become an empty ledger."""
    with pytest.raises(ConfigError, match="does not exist"):
        show(database=tmp_path / "typo.db")
    assert not (tmp_path / "typo.db").exists()


def test_which_database_is_meant_must_be_said() -> None:
    """By one of the two ways."""
    with pytest.raises(ConfigError, match="either --database or --config"):
        show()


def test_the_commands_are_registered() -> None:
    """`gelgate gel replace --help` answers."""
    done = subprocess.run(
        [Path(sys.executable).with_name("gelgate"), "gel", "replace", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "--serial" in done.stdout
