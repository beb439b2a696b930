"""`gelgate gel`: the ledger on the command line."""

import json
from functools import partial
from pathlib import Path

import pytest
import typer

from edge.cli.gel import prove, replace, show
from edge.core.errors import ConfigError, GelgateError
from edge.core.gel_life import GelLabel
from edge.core.gel_proof import MadeOn
from edge.core.part_position import PartPosition
from edge.store import gel_proofs
from edge.store.gel_proofs import GelBundle
from edge.store.outbox import Outbox
from edge.store.press_store import Store

T0 = 1_780_000_000 * 10**9


@pytest.mark.usefixtures("tokyo")
def test_show_prints_each_gel_on_a_line(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The mounted one is marked with *; times are local, with their offset."""
    show(database=database)

    out = capsys.readouterr().out
    assert out == (
        "* 2BNN4ZE7-1  sensor 2BNN4ZE7  1/1000 presses  good  mounted 2026-05-29 05:26:40+09:00, "
        "last used 2026-05-29 05:26:40+09:00  (first seen)\n"
    )


def test_replace_records_the_act_and_publishes_it(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The only sensor need not be named; history stays; the new gel waits in the outbox, retained."""
    replace(database=database, limit=500, note="torn")
    capsys.readouterr()
    show(database=database, as_json=True)

    old, new = json.loads(capsys.readouterr().out)
    assert (old["presses"], old["removed_ns"] is None) == (1, False)
    assert (new["gel_id"], new["presses"]) == ("2BNN4ZE7-2", 0)
    assert (new["limit_presses"], new["note"]) == (500, "torn")
    with Outbox(database) as outbox:
        (row,) = outbox.pending("mqtt")
    assert (row.message.topic, row.message.retain) == ("gel", True)
    with Store(database) as store:
        (act,) = store.acts(1)
    assert act.before == {"gel_id": "2BNN4ZE7-1", "presses": 1, "limit_presses": 1000}
    assert act.after == {"gel_id": "2BNN4ZE7-2", "presses": 0, "limit_presses": 500}


def test_with_two_sensors_one_must_be_named(database: Path) -> None:
    with Store(database) as store:
        store.gel("OTHER123", T0)

    with pytest.raises(ConfigError, match="known are 2BNN4ZE7, OTHER123; name one with --serial"):
        replace(database=database)


def bundle_on_a_new_gel(database: Path, presses: int) -> None:
    """A bundle that was used on the first gel, with presses without an alarm on the second one."""
    part, made = PartPosition("bolt", "crest"), MadeOn("2026-01-31")
    with Store(database) as store:
        for gel in (1, 2):
            key = GelBundle("2BNN4ZE7", f"2BNN4ZE7-{gel}", "b" * 64)
            store.write("", partial(gel_proofs.see, key=key, part=part, made=made, time_ns=T0))
            if gel == 1:
                store.replace_gel("2BNN4ZE7", T0)
        for _ in range(presses):
            store.write("", partial(gel_proofs.count, key=key, is_alarm=False))


def test_prove_is_refused_until_there_are_enough(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 1, the missing presses, and an act of each request; `show` says what is not proven."""
    bundle_on_a_new_gel(database, 21)
    show(database=database)
    why = "bundle bolt/crest (bbbbbbbb) is not yet proven on gel 2BNN4ZE7-2: it was used on gel 2BNN4ZE7-1"
    assert why in capsys.readouterr().out
    with pytest.raises(typer.Exit) as refused:
        prove(database=database)
    with Store(database) as store:
        key = GelBundle("2BNN4ZE7", "2BNN4ZE7-2", "b" * 64)
        store.write("", partial(gel_proofs.count, key=key, is_alarm=False))
    prove(database=database)
    prove(database=database)
    with Store(database) as store:
        acts = [(act.verb, act.outcome) for act in store.acts(2)]

    out = capsys.readouterr().out
    assert refused.value.exit_code == 1
    assert "Press 1 more sound parts without an alarm" in out
    assert "is proven on gel 2BNN4ZE7-2: on this gel 0 of 22 presses alarmed" in out
    assert out.endswith("every bundle that was used on the mounted gel is proven on it\n")
    assert acts == [("prove_gel", "done"), ("prove_gel", "refused")]


def test_a_bundle_that_another_has_replaced_is_named_no_more(
    database: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody can press what would prove it; in use again, it is named again."""
    bundle_on_a_new_gel(database, 0)
    named = []
    for bundle in "cb":
        with Store(database) as store:
            store.use_bundle(PartPosition("bolt", "crest"), None, bundle * 64, T0)
        show(database=database)
        named.append("(bbbbbbbb) is not yet proven" in capsys.readouterr().out)
    assert named == [False, True]


def test_prove_of_a_part_that_was_not_used_names_those_that_were(database: Path) -> None:
    """A mistyped part proves nothing."""
    bundle_on_a_new_gel(database, 22)
    with pytest.raises(
        ConfigError, match="no bundle of part 'nut' was used on the mounted gel; used were: bolt"
    ):
        prove(database=database, part="nut")


def test_what_a_package_says_is_kept_and_shown(database: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A gel that is past its date and was mounted before may be mounted, and it is said at once."""
    replace(database=database, gel_serial="G7 ", gel_type="markers", use_by="2001-01-31")
    replace(database=database, gel_serial="G7")
    said = capsys.readouterr().err.splitlines()
    show(database=database)
    with Store(database) as store:
        asked = store.acts(2)[-1].arguments

    assert (
        "* 2BNN4ZE7-3  serial G7  type markers  use by 2001-01-31 (past)  sensor 2BNN4ZE7  0/1000 presses"
        in (capsys.readouterr().out)
    )
    past = "gel 2BNN4ZE7-{} is past its use-by date 2001-01-31: mount another one"
    assert said[:2] == [past.format(2), past.format(3)]
    assert said[2] == "gel serial 'G7' was mounted before: its count goes on from 0 of 1000 presses"
    assert (asked["gel_serial"], asked["gel_type"], asked["use_by"]) == ("G7", "markers", "2001-01-31")


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"use_by": "2026-02-30"}, "no day of the calendar"),
        ({"gel_serial": "G9"}, "is on sensor OTHER123"),
        ({"gel_id": "G" * 9000}, "at most 64"),
    ],
)
def test_a_package_that_cannot_be_is_refused(database: Path, given: dict[str, str], sentence: str) -> None:
    """The old gel stays in the ledger."""
    with Store(database) as store:
        store.replace_gel("OTHER123", T0, label=GelLabel("G9"))
    with pytest.raises(GelgateError, match=sentence):
        replace(serial="2BNN4ZE7", database=database, **given)
    with Store(database) as store:
        assert store.gel("2BNN4ZE7", T0).gel_id == "2BNN4ZE7-1"
