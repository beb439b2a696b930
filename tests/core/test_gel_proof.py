"""Whether a bundle is proven on a gel: what is known at its first use, and how many presses show it."""

import re
from typing import Any

import pytest

from edge.core.binomial import upper_rate
from edge.core.gel_proof import GelProof, MadeOn, Proven, first_proof

OLD = MadeOn("2026-03-01")


@pytest.mark.parametrize(
    ("made", "mounted", "used", "known_from"),
    [
        (MadeOn("2026-03-01", "G1"), None, {}, "it was made on gel G1"),
        (OLD, None, {"used_on": "G1"}, "it was used on gel G1"),
        (OLD, None, {"was_in_use": True}, "it inspected here before this gel was mounted"),
        (
            OLD,
            None,
            {"is_restored": True},
            "the database was lost, so it is not known on which gel it was used",
        ),
        (OLD, "2026-03-02", {}, "it was made on 2026-03-01, and the gel was mounted on 2026-03-02"),
    ],
)
def test_a_bundle_of_another_gel_is_not_proven(
    made: MadeOn, mounted: str | None, used: dict[str, Any], known_from: str
) -> None:
    assert first_proof(made, "G2", mounted, **used) == GelProof(None, known_from)


@pytest.mark.parametrize(
    ("made", "mounted", "used_on", "proven"),
    [
        (MadeOn("2026-03-01", "G2"), "2026-03-02", "G1", Proven.MADE),
        (OLD, None, None, Proven.FIRST_USE),
        (OLD, "2026-03-01", None, Proven.FIRST_USE),
    ],
)
def test_a_bundle_that_can_be_of_this_gel_is_proven(
    made: MadeOn, mounted: str | None, used_on: str | None, proven: Proven
) -> None:
    """One that names this gel; and at its first use one that names none and is not older than the gel."""
    proof = first_proof(made, "G2", mounted, used_on)
    assert proof == GelProof(proven)
    assert proof.unproven("b", "G2") is None


def test_twenty_two_presses_without_an_alarm_are_enough() -> None:
    """1 - .9^22 is the first to reach .9: the exact binomial of ten percent, ninety percent sure."""
    assert GelProof(None, "x", 21).still_needed == 1
    assert [GelProof(None, "x", presses).still_needed for presses in (22, 23, 100)] == [0, 0, 0]
    assert 1 - 0.9**22 >= 0.9 > 1 - 0.9**21
    assert "alarmed, which allows 10.4% of false alarms" in GelProof(None, "x", 21).sentence  # more than 10 %


def test_an_alarm_asks_for_more_presses() -> None:
    """38 with one alarm allow ten percent at most."""
    proof = GelProof(None, "x", 22, 1)

    assert proof.presses + proof.still_needed == 38
    assert upper_rate(1, 38) <= 0.1 < upper_rate(1, 37)


def test_damaged_parts_are_no_reason_to_press_ever_more() -> None:
    """Of each two parts one fails: the text stays the same with every press, and claims no proof. With enough sound
    parts it asks for a number again."""
    half = {str(GelProof(None, "x", 2 * n, n).unproven("b", "G2")) for n in range(3, 200, 7)}
    later = str(GelProof(None, "x", 30, 3).unproven("b", "G2"))
    first = str(GelProof(None, "it was used on gel G1", 5).unproven("b", "G2"))

    assert ["no proof" in text and "not yet proven on gel G2: x" in text for text in half] == [True]
    assert "Press 35 more sound parts without an alarm" in later
    assert re.search("gel 0 of 5 presses .* allows 37% .* Press 17 more .*gelgate gel prove", first)
