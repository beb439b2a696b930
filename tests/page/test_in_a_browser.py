"""The page in headless Chromium: what a person sees and does."""

from collections.abc import Iterator
from typing import Any

import pytest
from chromium import BROWSER_MS
from page_messages import PICTURE, T0_NS, gel, info, press, state, stats

from edge.core.gel import GelState
from edge.core.verdict import Kind
from edge.messaging.alarm_advice import ADVICE
from edge.messaging.alarm_payload import AlarmPayload, alarm_message
from plugins.sinks.page import PageSink


@pytest.fixture
def tab(browser: Any, sink: PageSink) -> Iterator[Any]:
    """The page, opened; at the end there was no message on the console, and no request to another machine."""
    one = browser.new_page(viewport={"width": 1280, "height": 900})
    one.set_default_timeout(BROWSER_MS)
    said: list[str] = []
    one.on("console", lambda message: said.append(message.text))
    one.on("pageerror", lambda error: said.append(str(error)))
    one.on(
        "request", lambda request: said.append(request.url) if f":{sink.port}/" not in request.url else None
    )
    one.goto(f"http://127.0.0.1:{sink.port}/")
    yield one
    one.close()
    assert [line for line in said if not line.startswith("data:")] == []


def test_a_person_sees_the_verdict_as_it_comes(tab: Any, sink: PageSink) -> None:
    """Without loading the page again: verdict, why, picture, gel, alarm and state. Names are shown as text."""
    assert tab.inner_text("#verdict").lower() == "no press yet"

    for message in (
        state("ready"),
        gel(801, GelState.DUE),
        alarm_message(AlarmPayload(time_ns=T0_NS, alarm="gel", text="gel S-1 is due", severity="warning")),
        stats(mqtt="no broker answers"),
        info(),
        *press(1),
        *press(2, verdict=Kind.FAIL, score=2.5, score_ratio=2.5, part="<b>bolt</b>", picture=PICTURE),
    ):
        sink.send(message)

    tab.wait_for_selector("#verdict.fail")
    assert tab.inner_text("#verdict").lower() == "fail"
    assert "<b>bolt</b>" in tab.inner_text("#facts")
    assert "2.50 × threshold" in tab.inner_text("#facts")
    assert tab.inner_text("#alarms .alarm") == f"gel S-1 is due\nWhat to do: {ADVICE['gel']}"
    assert tab.inner_text("#selected") == "bolt/pos1"
    assert "GelSight Mini R0B, serial 2BNN4ZE7, 24.9 frames a second" in tab.inner_text("#sensor")
    assert "801 of 1000 presses, 199 left: due" in tab.inner_text("#gel")
    assert tab.inner_text("#state") == "ready"
    assert "mqtt: no broker answers" in tab.inner_text("#receivers")
    assert tab.locator("#presses tr").count() == 2
    tab.wait_for_function("document.getElementById('picture').naturalWidth > 0")


def test_a_press_without_a_score_is_an_error_on_the_page(tab: Any, sink: PageSink) -> None:
    """Never a pass, with the reason, and the picture of the press before is taken away."""
    for message in press(1, picture=PICTURE):
        sink.send(message)
    tab.wait_for_selector("#picture", state="visible")

    for message in press(2, verdict=None, score=None, score_ratio=None, error="saturated", picture=None):
        sink.send(message)

    tab.wait_for_selector("#verdict.error")
    assert tab.inner_text("#why") == "saturated"
    assert tab.locator("#picture").is_hidden()


def test_it_is_readable_on_a_phone(tab: Any, sink: PageSink) -> None:
    """One column, and nothing wider than the screen."""
    tab.set_viewport_size({"width": 390, "height": 844})
    outcome = {"verdict": Kind.REJECTED, "score": None, "score_ratio": None}
    for message in (
        *press(1, part="a_very_long_name_of_a_part_without_a_blank", picture=PICTURE),
        *press(2, **outcome, reason="off_position: press again", picture=PICTURE),
    ):
        sink.send(message)

    tab.wait_for_selector("#verdict.rejected")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_gateway_that_is_gone_is_seen(browser: Any, sink: PageSink) -> None:
    """The page says so, and the last verdict is grey: it is not news."""
    one = browser.new_page()
    one.set_default_timeout(BROWSER_MS)
    one.goto(f"http://127.0.0.1:{sink.port}/")

    sink.close()

    one.wait_for_selector("#state.lost")
    assert one.inner_text("#state") == "the gateway does not answer"
    assert one.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "0.35"
    one.close()
