"""What is said of the contact, frame by frame: worked by hand, and from frames of a ball."""

from collections.abc import Callable

import pytest
from ball_frames import PROFILE, frames

from edge.core.contact.events import PressSettled
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.reference import Reference
from edge.core.contact.settings import ContactSettings
from edge.core.contact_state import ContactFollower, ContactState
from edge.core.imaging.decode import decode_view
from edge.core.imaging.quality import NominalStrength

FREE, HELD = [0.0] * 45, [0.2, 0.3, 0.4, 0.5, 0.6, 0.8, *[1.0] * 12]
LIFT = [0.5, 0.2, *[0.0] * 6]
OF_FULL = NominalStrength(5.0, 6.8, 7.0)
"""The ball at its full depth has 6.8 levels, at half of it 3.5."""


def follow(
    depths: list[float | None],
    nominal: NominalStrength | None = OF_FULL,
    *,
    is_external: bool = False,
    records: Callable[[int], bool] = lambda number: True,
) -> list[ContactState]:
    """Return the states in order, each once; presses are judged at once, and recorded where `records` the frame."""
    free = Reference(decode_view(next(frames([0.0])), PROFILE))
    detector = PressDetector(PROFILE, ContactSettings(is_external=is_external), free)
    follower = ContactFollower()
    follower.nominal = nominal
    said: list[ContactState] = []

    def note() -> None:
        if said[-1:] != [follower.state]:
            said.append(follower.state)

    judged: list[str] = []
    for number, frame in enumerate(frames(depths)):
        look = detector.feed(frame)
        for event in look.events:
            follower.see(event)
            note()
            if isinstance(event, PressSettled):
                judged.append(str(event.began_ns))
                follower.judge(judged[-1])
                note()
        follower.look(look)
        note()
        if judged and records(number):
            follower.record(judged[-1])
            note()
    return said


WHOLE = ["unknown", "free", "touching", "pressing", "deep_enough", "at_rest", "judged", "lift", "free"]
LIGHT = [state for state in WHOLE[:-1] if state != "deep_enough"]


@pytest.mark.parametrize(
    ("depths", "given", "said"),
    [
        ([*FREE, *HELD, *LIFT], {}, WHOLE),
        ([*FREE, *HELD, *LIFT, *FREE[:20], *HELD, *LIFT], {}, [*WHOLE, *WHOLE[2:]]),
        (
            [*FREE, *HELD, *LIFT],
            {"nominal": None},
            ["unknown", "free", "touching", "pressing", "at_rest", "judged", "lift", "free"],
        ),
        (
            [*FREE, *HELD, *LIFT],
            {"is_external": True},
            [*WHOLE[:6], "pressing", "free"],
        ),
        ([*FREE, *HELD, *LIFT], {"records": lambda number: False}, [*WHOLE[:7], "free"]),
        (
            [*FREE, *HELD, *LIFT],
            {"nominal": NominalStrength(0.1, 0.1, 0.1)},
            ["unknown", "free", "overload", "free"],
        ),
        ([*FREE, *HELD, *[None] * 8, *HELD[6:], *LIFT, *FREE[:9]], {}, [*WHOLE[:8], "unknown", "free"]),
        (
            [*FREE, 0.2, 0.5, *[None] * 8, *[1.0] * 25, *LIFT],
            {},
            ["unknown", "free", "touching", "unknown", "touching", *WHOLE[4:]],
        ),
        ([*HELD[6:], *HELD[6:], *FREE], {}, ["unknown", "free"]),
        (
            [*FREE, *HELD, *[None] * 8, *FREE[:10], *HELD[6:], *LIFT, *FREE[:9]],
            {},
            [*WHOLE[:8], "unknown", "free", "unknown", "free"],
        ),
        ([*FREE, *HELD, 0.0, *HELD, *LIFT, *FREE[:9]], {}, [*WHOLE, "unknown", "free"]),
        ([*FREE, *HELD, 0.0, *HELD, *LIFT, *FREE[:9], *HELD], {}, [*WHOLE, "unknown", *WHOLE[1:8]]),
        ([*FREE, *[0.15] * 20, *HELD[6:], *FREE[:9]], {}, [*LIGHT, "unknown", "free"]),
        ([*FREE, *[0.5] * 20, *HELD[6:], *FREE[:9]], {}, [*LIGHT, "free"]),
    ],
    ids=[
        "a press",
        "two presses",
        "a bundle that does not know its strength",
        "no trigger comes",
        "nothing is recorded",
        "far deeper than at fit",
        "an interruption after the verdict: perhaps another part",
        "an interruption before it",
        "pressed at the start",
        "an interruption after the verdict, and another part before its press was over",
        "free for a frame: perhaps another part",
        "free for a frame, and a press after it",
        "a mark that was taken for a press, and a part over it",
        "pressed deeper after its verdict",
    ],
)
def test_states(depths: list[float | None], given: dict[str, object], said: list[str]) -> None:
    assert follow(depths, **given) == said  # type: ignore[arg-type]


def test_a_press_recorded_late_lifts_no_other() -> None:
    """The first one is recorded while the second is held."""
    follower = ContactFollower()
    follower.judge("first")
    follower.judge("second")
    follower.state = "judged"
    follower.record("first")
    assert follower.state == "judged"
    follower.record("second")
    assert follower.state == "lift"


@pytest.mark.parametrize("strengths", [(0.0, 1.0, 2.0), (2.0, 1.0, 3.0), (1.0, 3.0, 2.0)])
def test_strengths_rise(strengths: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="lowest <= middle <= highest"):
        NominalStrength(*strengths)
