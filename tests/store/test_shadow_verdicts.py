"""What people said of presses that a shadow has not judged."""

from functools import partial

from recorded_presses import T0

from edge.core.part_position import PartPosition
from edge.store.acts import CONFIRM, Act
from edge.store.press_store import Store
from edge.store.shadow_verdicts import Unjudged, read_judged_twice

PRESS_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


def test_a_damage_of_a_press_older_than_the_history_is_not_forgotten(store: Store) -> None:
    """Its part is not known any more, so it may be of this one."""
    given = {"press_id": PRESS_ID, "verdict": "damaged"}
    store.begin_act(Act(T0, "kim, at the page", CONFIRM, None, given, outcome="done"))
    read = partial(read_judged_twice, part=PartPosition("bolt", None), bundle_id="b", beside="a")
    assert store.read("reading", read) == ([], [Unjudged(PRESS_ID, "", None, "damaged")])
