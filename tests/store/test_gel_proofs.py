"""The table of bundles on gels: what is known of a bundle on a gel outlives the process, and rises by presses alone."""

from functools import partial
from pathlib import Path

import pytest
from recorded_presses import count, make_press

from edge.core.gel_proof import GelProof, MadeOn, Proven
from edge.core.part_position import PartPosition
from edge.core.press import ShadowVerdict
from edge.store import gel_proofs
from edge.store.gel_proofs import GelBundle
from edge.store.press_store import Store

SERIAL, PART = "2BNN4ZE7", PartPosition("bolt", "crest")
DAY_NS = 86_400 * 10**9
T0 = 20_600 * DAY_NS  # in May 2026
MADE = MadeOn("2026-01-31")


def key(gel: int, bundle: str = "b" * 64) -> GelBundle:
    return GelBundle(SERIAL, f"{SERIAL}-{gel}", bundle)


def see(store: Store, of: GelBundle, made: MadeOn = MADE, time_ns: int = T0) -> GelProof:
    return store.write("seeing", partial(gel_proofs.see, key=of, part=PART, made=made, time_ns=time_ns))


def press(store: Store, of: GelBundle, times: int, *, is_alarm: bool = False) -> None:
    for _ in range(times):
        store.write("pressing", partial(gel_proofs.count, key=of, is_alarm=is_alarm))


def prove(store: Store, of: GelBundle) -> GelProof:
    return store.write("proving", partial(gel_proofs.prove, key=of, part=PART))


@pytest.fixture
def mounted(store: Store) -> Store:
    """The first gel of a sensor."""
    store.gel(SERIAL, T0)
    return store


def test_a_bundle_is_proven_on_its_first_gel_and_not_on_the_next(mounted: Store) -> None:
    """The first gel is the one on which it is seen first; the second is another one."""
    first = see(mounted, key(1))
    mounted.replace_gel(SERIAL, T0 + DAY_NS)
    second = see(mounted, key(2), time_ns=T0 + DAY_NS)

    assert first.proven is Proven.FIRST_USE
    assert second == GelProof(None, f"it was used on gel {SERIAL}-1")


def test_a_drawn_revision_was_used_last_where_the_bundle_was(mounted: Store) -> None:
    """It has all proofs from one moment on."""
    for gel in (1, 2):
        see(mounted, key(gel))
        mounted.replace_gel(SERIAL, T0 + gel * DAY_NS)
    drawn = partial(gel_proofs.inherit, old_id="b" * 64, new_id="d" * 64, time_ns=T0, with_presses=True)
    mounted.write("drawing", drawn)

    assert see(mounted, key(3, "d" * 64)).known_from == f"it was used on gel {SERIAL}-2"


def test_a_bundle_that_inspected_before_the_table_was_there_is_unproven_on_a_new_gel(mounted: Store) -> None:
    """Its use is known from the record of bundles in use: a database of an older version has no other."""
    mounted.use_bundle(PART, 1, "b" * 64, T0 + 1)
    mounted.replace_gel(SERIAL, T0 + DAY_NS)

    assert see(mounted, key(2)).known_from == "it inspected here before this gel was mounted"


def test_a_shadow_of_the_gel_before_is_unproven_on_a_new_gel(mounted: Store) -> None:
    """Also one that was made on the day of the change; one that has judged presses of this gel alone is of this gel."""
    before, since = (ShadowVerdict(one * 64, "b" * 64, "pass", 0.1, 1.0).encode() for one in "cd")
    count(mounted, make_press(1, shadow=before))
    mounted.replace_gel(SERIAL, T0 + 2 * DAY_NS)
    count(mounted, make_press(3 * DAY_NS // 10**9, shadow=since))
    young = MadeOn("2099-01-01")

    assert see(mounted, key(2, "c" * 64), young).known_from == "it inspected here before this gel was mounted"
    assert see(mounted, key(2, "d" * 64), young).proven is Proven.FIRST_USE


def test_a_bundle_made_before_the_gel_was_mounted_is_not_proven(mounted: Store) -> None:
    """By the two dates; the date of a sensor's first gel says nothing, for it may be older than the database."""
    old = see(mounted, key(1))
    mounted.replace_gel(SERIAL, T0 + DAY_NS)

    assert old.proven is Proven.FIRST_USE
    assert see(mounted, key(2, "c" * 64)).known_from.startswith("it was made on 2026-01-31, and the gel was")
    assert see(mounted, key(2, "d" * 64), MadeOn("2099-01-01")).proven is Proven.FIRST_USE


def test_nothing_is_proven_on_the_gel_of_a_lost_database(mounted: Store, path: Path) -> None:
    """The second record does not know where a bundle was used; one that names the gel is proven."""
    see(mounted, key(1))
    mounted.replace_gel(SERIAL, T0 + DAY_NS)
    count(mounted, make_press(1, serial=SERIAL))
    assert see(mounted, key(2)).proven is None
    mounted.close()
    path.unlink()

    with Store(path) as again:
        assert again.gel(SERIAL, T0 + 2 * DAY_NS).gel_id == key(2).gel_id
        of_bundle, of_gel = (
            see(again, key(2)),
            see(again, key(2, "c" * 64), MadeOn("2026-01-31", key(2).gel_id)),
        )

    assert (of_bundle.proven, of_gel.proven) == (None, Proven.MADE)
    assert of_bundle.known_from == "the database was lost, so it is not known on which gel it was used"


def test_counts_outlive_the_process(mounted: Store, path: Path) -> None:
    """Presses and alarms of one bundle on one gel."""
    see(mounted, key(1))
    mounted.replace_gel(SERIAL, T0 + DAY_NS)
    see(mounted, key(2))
    press(mounted, key(2), 3)
    press(mounted, key(2), 1, is_alarm=True)
    mounted.close()

    with Store(path) as again:
        ((of, part, proof),) = again.read("reading", gel_proofs.of_mounted)
    assert (of, part, proof.presses, proof.alarms) == (key(2), PART, 4, 1)


def test_a_word_without_presses_proves_nothing(mounted: Store) -> None:
    """The refusal says how many are missing; with enough it is proven, once. Until then the gel is a new one for it."""
    find_gel = partial(gel_proofs.unproven_gel, bundle_id="b" * 64)
    see(mounted, key(1))
    mounted.replace_gel(SERIAL, T0 + DAY_NS)
    see(mounted, key(2))
    press(mounted, key(2), 21)
    with pytest.raises(ValueError, match="Press 1 more sound parts"):
        prove(mounted, key(2))

    press(mounted, key(2), 1)
    assert mounted.read("reading", find_gel) == key(2)
    assert prove(mounted, key(2)).proven is Proven.PRESSES
    assert mounted.read("reading", find_gel) is None
    press(mounted, key(2), 1, is_alarm=True)
    assert see(mounted, key(2)).alarms == 0
    with pytest.raises(ValueError, match="is proven on gel 2BNN4ZE7-2 already: presses"):
        prove(mounted, key(2))


def test_a_bundle_that_was_never_used_on_the_gel_cannot_be_proven(mounted: Store) -> None:
    with pytest.raises(ValueError, match="was not used on gel 2BNN4ZE7-1 yet; press sound parts first"):
        prove(mounted, key(1))
