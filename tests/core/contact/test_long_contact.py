"""A contact that never ends is said, measured against the usual ones."""

import pytest

from edge.core.contact.sight import LongContact

S = 1_000_000_000


@pytest.mark.parametrize(
    ("lengths_s", "alarm_s"), [([], 15.0), ([0.6] * 3, 3.0), ([2.0, 30.0, 2.0], 8.0), ([60.0] * 9, 240.0)]
)
def test_alarm_at_four_times_the_usual_length_fault_at_eight(lengths_s: list[float], alarm_s: float) -> None:
    """At least 3 s; 15 s where no length is known yet; one long contact among short ones does not change it."""
    contact, now = LongContact(), 0
    for length in lengths_s:
        contact.begin(now)
        now += round(length * S)
        contact.end(now)
    contact.begin(now)
    at = {share: contact.look(now + round(share * alarm_s * S)) for share in (0.99, 1.01, 1.99, 2.01)}
    assert [(text is None, is_fault) for text, is_fault in at.values()] == [
        (True, False),
        (False, False),
        (False, False),
        (False, True),
    ]
    contact.end(now + S)
    assert contact.look(now + 1000 * S) == (None, False)
