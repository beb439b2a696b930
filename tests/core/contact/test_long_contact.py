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


def test_a_time_in_which_nothing_was_seen_is_no_part_of_it() -> None:
    """A part that was lifted while the sensor was unplugged has not pressed the gel since."""
    contact = LongContact()
    contact.leave_out(100.0, 0)
    contact.begin(0)
    contact.leave_out(20.0, 21 * S)
    assert [contact.look(at * S)[0] is None for at in (21, 34, 36)] == [True, True, False]
    contact.begin(50 * S)
    contact.leave_out(20.0, 50 * S)  # it was over when the press began
    assert [contact.look(at * S)[0] is None for at in (64, 66)] == [True, False]


def test_a_sensor_that_shows_little_does_not_hide_it() -> None:
    contact = LongContact()
    contact.begin(0)
    for second in range(1, 16):
        contact.leave_out(1.0, second * S)
    assert contact.look(16 * S)[0] is not None


def test_a_gel_that_is_pressed_again_before_the_press_is_over_is_said() -> None:
    """What lay there and what lies there now are one press, and perhaps two parts."""
    contact = LongContact()
    contact.see("free")
    contact.begin(0)
    for phase in ("pressed", "decided", "free", "unseen"):
        contact.see(phase)
        assert contact.look(S)[0] is None
    contact.see("decided")
    sentence, is_fault = contact.look(S)
    assert "neither judged nor counted" in str(sentence)
    assert not is_fault
    assert contact.look(31 * S)[1]
    contact.end(2 * S)
    assert contact.look(2 * S)[0] is None
    contact.begin(3 * S)
    contact.see("pressed")
    assert contact.look(4 * S)[0] is None


def test_a_part_over_what_was_taken_for_a_press_is_neither_judged_nor_counted() -> None:
    """That is said until the gel is free, also where little of the part shows in some views."""
    contact = LongContact()
    contact.see("over it")
    contact.begin(0)
    contact.see("decided")
    assert contact.look(S)[0] is None
    for phase in ("over it", "decided"):
        contact.see(phase)
        sentence, is_fault = contact.look(S)
        assert "a part that came meanwhile is neither judged nor counted" in str(sentence)
        assert not is_fault
    contact.end(2 * S)
    assert contact.look(2 * S)[0] is None
