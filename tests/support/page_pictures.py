"""The pictures of the page in docs/images: `make page-pictures`. They are drawn from messages, without a station."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from unittest import mock

import cv2
import numpy as np
from chromium import chromium, open_tab, wait_until
from page_messages import PICTURE, T0_NS, gel, info, press, state, stats

from edge.clock import SystemClock
from edge.config.feature_tables import CommandTable
from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.core.sink_context import PageRequests
from edge.core.verdict import Kind
from edge.messaging.alarm_payload import AlarmPayload
from edge.messaging.command_payloads import CommandResponse
from edge.page.server import PageServer
from edge.page.settings import PageSettings
from edge.page.shown import Shown

TOKEN: Final = "correct-horse"

# The press of the README's picture, as it is written there.
SCORE, THRESHOLD = 3.427, 1.0
PART: Final = {"part": "PZ1", "position": "pos1"}
REJECTED: Final = {"picture": None, "verdict": Kind.REJECTED, "score": None, "score_ratio": None}

PASSED: Final = (
    *press(1, **PART, picture=None),
    *press(2, **PART, picture=None, score=0.71 * THRESHOLD, score_ratio=0.71),
    *press(3, **PART, **REJECTED, reason="off_position: press again"),
    *press(4, **PART, picture=None, score=0.62 * THRESHOLD, score_ratio=0.62),
)
FAILED: Final = press(
    5,
    **PART,
    picture=PICTURE,
    verdict=Kind.FAIL,
    score=SCORE,
    threshold=THRESHOLD,
    score_ratio=SCORE / THRESHOLD,
)
READY: Final = (
    state("ready"),
    info(**PART, parts=("PZ1/pos1", "PZ3/pos1")),
    gel(412, GelState.GOOD),
    stats(mqtt="up, MQTT 5"),
)
WORN: Final = gel(812, GelState.DUE)
DUE: Final = AlarmPayload(
    time_ns=T0_NS,
    alarm="gel",
    severity="warning",
    text="gel S-1 is due: 812 of 1000 presses; then `gelgate gel replace`",
).message()
DROPPED: Final = AlarmPayload(
    time_ns=T0_NS, alarm="outbox_full", text="unsent messages were dropped: 3 of kind heatmap (no room)"
).message()
AWAY: Final = "broker 192.168.1.5:1883 does not answer (Connection refused); trying again"


@dataclass(frozen=True)
class Scene:
    """What the page shows in one picture. size: of the window in CSS pixels."""

    messages: Sequence[Message]
    size: tuple[int, int] = (1280, 900)
    is_dark: bool = False
    is_unlocked: bool = False
    away: str | None = None
    waits_for: str = "#verdict.fail"


SCENES: Final = {
    "page": Scene((*READY, DUE, WORN, *PASSED, *FAILED), is_unlocked=True),
    "page_alarm": Scene(
        (*READY, DROPPED, DUE, WORN, *PASSED, *FAILED), (900, 700), is_dark=True, is_unlocked=True
    ),
    "page_away": Scene((*READY, *PASSED), (900, 480), away=AWAY, waits_for="#verdict.none"),
}
"""Name of the file to scene."""


def _answer(verb: str, payload: bytes, why: str | None = None) -> bytes:
    status = "ok" if why is None else "error"
    return CommandResponse(time_ns=T0_NS, transaction=None, verb=verb, status=status, error=why).encode()  # type: ignore[arg-type]


@contextmanager
def served(scene: Scene) -> Iterator[int]:
    """The page of the scene; gives its port."""
    clock = SystemClock()
    shown = Shown("plant/line1/press2", scene.away)
    for message in scene.messages:
        shown.see(message)
    verbs = PageRequests(frozenset(CommandTable().page), _answer, _answer)
    with mock.patch.dict(os.environ, TOKEN_OF_THE_PAGE=TOKEN):
        server = PageServer(shown, PageSettings(token_variable="TOKEN_OF_THE_PAGE"), verbs, clock, port=0)
    yield server.port
    server.close()


def picture_of(browser: Any, scene: Scene) -> bytes:
    """PNG with a palette of 256 colours, so that it is small."""
    width, height = scene.size
    with served(scene) as port:
        scheme = "dark" if scene.is_dark else "light"
        tab = open_tab(browser, port, viewport={"width": width, "height": height}, color_scheme=scheme)
        tab.wait_for_selector(scene.waits_for)
        wait_until(tab, "document.getElementById('picture').complete")
        if scene.is_unlocked:
            tab.fill("#token", TOKEN)
            tab.press("#token", "Enter")
            tab.wait_for_selector("#new-gel", state="visible")
            tab.evaluate(
                "document.querySelector('aside').scrollTo(0, 0); scrollTo(0, 0); document.activeElement.blur()"
            )
        shot = bytes(tab.screenshot())
        tab.close()
    return _small(shot)


def _small(png: bytes) -> bytes:
    """Stronger compression than the browser's."""
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def main(folder: Path) -> None:
    """Write every picture."""
    with chromium() as browser:
        for name, scene in SCENES.items():
            (folder / f"{name}.png").write_bytes(picture_of(browser, scene))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
