"""The page in headless Chromium: what a person sees."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import PICTURE, T0_NS, gel, info, press, state, stats

from edge.core.gel import GelState
from edge.core.gel_scars.causes import Cause
from edge.core.verdict import Kind
from edge.messaging.alarm_payload import ADVICE, AlarmPayload, alarm_message
from edge.messaging.result_payload import PressAgainPart
from plugins.sinks.page import PageSink

# Of each text: its words, and the contrast to the nearest background that covers. Ref: WCAG 2.2, relative luminance.
CONTRASTS = """() => {
  const numbers = (colour) => colour.match(/[0-9.]+/g).map(Number);
  const linear = (c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => [r, g, b].map((c) => linear(c / 255))
    .reduce((sum, c, n) => sum + c * [0.2126, 0.7152, 0.0722][n], 0);
  const behind = (one) => {
    const back = numbers(getComputedStyle(one).backgroundColor);
    return back.length < 4 || back[3] === 1 ? back : one.parentElement ? behind(one.parentElement) : [255, 255, 255];
  };
  return [...document.querySelectorAll("body *")]
    .filter((one) => one.checkVisibility())
    .filter((one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim()))
    .map((one) => {
      const [a, b] = [light(numbers(getComputedStyle(one).color)), light(behind(one))];
      return [one.textContent, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
    });
}"""


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
        info(warnings=("not proven: the bundle finds 1 of 48", "20 presses promise 1/21 at best")),
        *press(1),
        *press(2, verdict=Kind.FAIL, score=2.5, score_ratio=2.5, part="<b>bolt</b>", picture=PICTURE),
    ):
        sink.send(message)

    tab.wait_for_selector("#verdict.fail")
    assert tab.inner_text("#verdict").lower() == "fail"
    assert "<b>bolt</b>" in tab.inner_text("#facts")
    assert "2.50 × threshold" in tab.inner_text("#facts")
    assert tab.inner_text("#alarms .alarm") == f"gel S-1 is due\nWhat to do: {ADVICE['gel']}".replace("`", "")
    assert tab.inner_text("#selected") == "bolt/pos1"
    assert tab.inner_text("#unproven") == "not proven: the bundle finds 1 of 48"
    assert "GelSight Mini R0B, serial 2BNN4ZE7, 24.9 frames a second" in tab.inner_text("#sensor")
    assert "801 of 1000 presses, 199 left: due" in tab.inner_text("#gel")
    assert (tab.inner_text("#state"), tab.get_attribute("#state", "class")) == ("ready, 1 alarm", "alarmed")
    assert "mqtt: no broker answers" in tab.inner_text("#receivers")
    assert tab.locator("#presses tr").count() == 2
    wait_until(tab, "document.getElementById('picture').naturalWidth > 0")


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


def test_a_press_that_asks_for_a_second_one_says_so_on_the_page(tab: Any, sink: PageSink) -> None:
    """Where the reason of a verdict is."""
    asked = PressAgainPart(is_asked=True, reason="press the same piece again, a little shifted")
    for message in press(1, verdict=Kind.UNSURE, press_again=asked):
        sink.send(message)

    tab.wait_for_selector("#verdict.unsure")
    assert tab.inner_text("#why") == "press the same piece again, a little shifted"


def test_the_cause_of_a_fail_is_shown(tab: Any, sink: PageSink) -> None:
    """Gel or part, and why: it says whether to wipe the gel or to put the part aside."""
    for message in press(1, verdict=Kind.FAIL, cause=Cause.GEL, cause_text="the free gel shows a mark there"):
        sink.send(message)

    tab.wait_for_selector("#verdict.fail")
    assert tab.inner_text("#why") == "cause: gel"
    assert tab.inner_text("#cause") == "the free gel shows a mark there"


@pytest.mark.parametrize(
    ("score_ratio", "shown"), [(1.0021, "1.002"), (0.99999, "0.99999"), (1.0, "1.00"), (1.19, "1.19")]
)
def test_a_fail_never_reads_as_its_threshold(
    tab: Any, sink: PageSink, score_ratio: float, shown: str
) -> None:
    """In the line below the verdict and in the list."""
    for message in press(1, verdict=Kind.FAIL, score=score_ratio, score_ratio=score_ratio):
        sink.send(message)

    tab.wait_for_selector("#verdict.fail")
    assert f"{shown} × threshold" in tab.inner_text("#facts")
    assert tab.inner_text("#presses td:nth-child(2)") == shown


@pytest.mark.parametrize("width", [320, 390, 768, 1000])
def test_nothing_is_wider_than_the_screen(tab: Any, sink: PageSink, width: int) -> None:
    """From a small phone on; the picture is whole, and a link to its own size."""
    tab.set_viewport_size({"width": width, "height": 844})
    outcome = {"verdict": Kind.REJECTED, "score": None, "score_ratio": None}
    for message in (
        *press(1, part="a_very_long_name_of_a_part_without_a_blank", picture=PICTURE),
        *press(2, **outcome, reason="off_position: press again", picture=PICTURE),
    ):
        sink.send(message)

    tab.wait_for_selector("#verdict.rejected")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate("document.getElementById('picture').getBoundingClientRect().right") <= width
    assert (tab.get_attribute("#frame", "href") or "").startswith("pictures/")


@pytest.mark.parametrize("size", [(1280, 900), (1920, 1080)])
def test_the_verdict_is_readable_from_two_metres(tab: Any, sink: PageSink, size: tuple[int, int]) -> None:
    """Letters of 10 mm for each 2 m (ISO 9355-2: 15 to 20 minutes of arc), on a screen of 96 pixels an inch."""
    tab.set_viewport_size({"width": size[0], "height": size[1]})
    for message in press(
        1, verdict=Kind.REJECTED, score=None, score_ratio=None, reason="off_position: again"
    ):
        sink.send(message)
    tab.wait_for_selector("#verdict.rejected")

    font_px = float(tab.evaluate("parseFloat(getComputedStyle(document.getElementById('verdict')).fontSize)"))
    capital_mm = 0.7 * font_px / 96 * 25.4
    assert capital_mm >= 2000 * math.tan(math.radians(20 / 60))


def test_alarms_and_verdicts_are_announced(tab: Any, sink: PageSink) -> None:
    """To a screen reader: roles, names, and a name for every control."""
    for message in (state("ready"), info(), gel(801, GelState.DUE), *press(1, picture=PICTURE)):
        sink.send(message)
    tab.wait_for_selector("#verdict.pass")
    tab.get_by_role("img", name="pass, bolt").wait_for()  # its picture comes after the verdict

    assert tab.get_attribute("#verdict", "aria-live") == "assertive"
    assert tab.get_by_role("meter", name="Gel").get_attribute("aria-valuenow") == "80"
    assert tab.get_by_role("table", name="Last presses").count() == 1
    assert tab.get_by_role("img", name="pass, bolt").count() == 1
    assert [role for role in ("status", "region", "main") if tab.get_by_role(role).count() == 0] == []
    unnamed = "[...document.querySelectorAll('input, select')].filter((one) => !one.labels.length).length"
    assert tab.evaluate(unnamed) == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_by_day_and_by_night(browser: Any, sink: PageSink, scheme: str) -> None:
    """Contrast of at least 4.5 (WCAG 2.2, 1.4.3), of everything that is written."""
    for message in (state("ready"), info(), gel(801, GelState.DUE), *press(1, picture=PICTURE), *press(2)):
        sink.send(message)
    sink.send(alarm_message(AlarmPayload(time_ns=T0_NS, alarm="gel", text="`due`", severity="warning")))
    one = browser.new_page(color_scheme=scheme)
    one.set_default_timeout(BROWSER_MS)
    one.goto(f"http://127.0.0.1:{sink.port}/")
    one.wait_for_selector("#verdict.pass")
    low = one.evaluate(CONTRASTS)
    one.close()

    assert [words for words, contrast in low if contrast < 4.5] == []
    assert len(low) > 20


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
