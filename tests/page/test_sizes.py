"""The page on a phone, a desk and a television: press and heatmap are whole."""

from typing import Any

from chromium import open_tab, wait_until
from page_messages import PICTURE, T0_NS, drift, gel, info, press, state, stats
from page_pictures import TOKEN, Scene, served

from edge.core.gel_life import GelState
from edge.core.verdict import Cause, Kind
from edge.messaging.alarm_payload import AlarmPayload
from plugins.sinks.page import PageSink

WHOLE = """(() => { const image = document.getElementById('picture'), box = image.getBoundingClientRect();
  return image.naturalWidth > 0 && box.width > 150 && box.height > 150 && box.top >= 0 && box.left >= 0
    && box.bottom <= innerHeight && box.right <= innerWidth; })()"""

ALL_SEEN = """(() => { const alarms = document.getElementById('alarms');
  return alarms.children.length === 3 && alarms.scrollHeight <= alarms.clientHeight
    && document.getElementById('picture').clientHeight >= innerHeight / 2; })()"""
BROKEN = """(() => {
  const words = [], texts = document.createTreeWalker(document.querySelector("table"), NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const node = texts.currentNode, range = new Range();
    for (const { 0: word, index } of node.data.matchAll(/[^ /]+/g)) {
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      if (range.getClientRects().length > 1) { words.push(word); }
    }
  }
  return words; })()"""
TEXT = "the disk of /var/lib/gelgate has 212 MB free, expected at least 500 MB; make room"


SIZES = {
    "phone": (390, 844),
    "tablet": (1024, 768),
    "desk": (1280, 800),
    "large desk": (1440, 900),
    "television": (1920, 1080),
}


def test_press_and_heatmap_need_no_scrolling(browser: Any, sink: PageSink) -> None:
    """Also below three alarms and above a long reason; nothing is wider than the window. Only the styles
    know its size, so one page is made larger."""
    alarms = [
        AlarmPayload(time_ns=T0_NS, alarm=name, text=f"{name}: {TEXT}").message()
        for name in ("gel", "outbox_full", "disk")
    ]
    failed = press(
        1, picture=PICTURE, verdict=Kind.FAIL, cause=Cause.GEL, cause_text="a mark at the same place"
    )
    for message in (
        state("ready"),
        info(),
        gel(801, GelState.DUE),
        stats(mqtt="up"),
        drift(-1),
        *alarms,
        *failed,
    ):
        sink.send(message)
    tab = open_tab(browser, sink.port, viewport={"width": 390, "height": 844})
    tab.wait_for_selector("#charts li.shifted")
    wait_until(tab, "document.getElementById('picture').complete")

    for name, (width, height) in SIZES.items():
        tab.set_viewport_size({"width": width, "height": height})
        assert tab.evaluate(WHOLE), name
        assert tab.evaluate("document.scrollingElement.scrollWidth <= innerWidth"), name
        assert tab.locator("#presses a").bounding_box()["height"] >= 44, "a finger does not hit it"
        if width >= 1440:
            tab.select_option("#language", "de")
            tab.wait_for_selector("html[lang=de]")
            assert tab.evaluate(ALL_SEEN), name
            tab.select_option("#language", "en")
    tab.close()


def test_a_phone_shows_the_worst_alarm_and_a_line_opens_the_others(browser: Any, sink: PageSink) -> None:
    """An error comes before the warnings that were there first, and a list that changes stays open."""
    for alarm, severity in (("gel", "warning"), ("receiver", "warning"), ("outbox_full", "error")):
        text = f"{alarm}: {TEXT}"
        sink.send(AlarmPayload(time_ns=T0_NS, alarm=alarm, text=text, severity=severity).message())  # type: ignore[arg-type]
    tab = open_tab(browser, sink.port, viewport={"width": 390, "height": 844})
    tab.wait_for_selector("#alarms .alarm")

    seen = "[...document.querySelectorAll('#alarms .alarm')].filter(row => row.checkVisibility()).length"
    whole = "document.getElementById('alarms').scrollHeight <= document.getElementById('alarms').clientHeight"
    assert tab.evaluate(seen) == 1
    assert tab.inner_text("#alarms > .alarm").startswith("outbox_full: ")
    line = "The gel is worn; A receiver works with a fault"
    assert tab.inner_text("#alarms summary") == f"2 more alarms: {line}"
    assert tab.evaluate(whole)

    tab.click("#alarms summary")
    assert tab.evaluate(seen) == 3
    sink.send(AlarmPayload(time_ns=T0_NS, alarm="disk", text=TEXT).message())
    wait_until(tab, f"{seen} === 4")
    tab.close()


def test_no_word_of_the_last_presses_is_broken_on_a_phone(browser: Any) -> None:
    """A part breaks at its slash, also beside the buttons of who has the token."""
    pressed = press(1, part="dado", position="default", picture=None)
    with served(Scene((state("ready"), info(), *pressed))) as port:
        tab = open_tab(browser, port, viewport={"width": 390, "height": 844})
        tab.fill("#token", TOKEN)
        tab.press("#token", "Enter")
        tab.wait_for_selector("#say-head", state="visible")
        assert tab.evaluate(BROKEN) == []
        tab.close()
