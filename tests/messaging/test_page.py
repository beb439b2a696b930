"""The page for the people at the station: what it serves, to whom, and how it looks in headless Chromium."""

import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS

from edge.core.errors import ConfigError, SinkRejected
from edge.core.gel import GelState
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.core.verdict import Kind
from edge.messaging.alarm_payload import AlarmPayload, alarm_cleared, alarm_message
from edge.messaging.gel_payload import GelPayload, gel_message
from edge.messaging.result_payload import ResultPayload, heatmap_message
from edge.messaging.status_payloads import StatePayload, StatsPayload, state_message, stats_message
from edge.store.ulid import new_ulid
from plugins.sinks.page import MOST_PICTURES, MOST_PRESSES, PageOptions, PageSink, plugin

ROOT = "gelgate/plant/line1/press2/gel/v1"
T0_NS = 1_769_860_800 * 10**9
PICTURE = (Path(__file__).parents[2] / "docs" / "images" / "damaged_press.png").read_bytes()
LARGEST_PAGE_BYTES = 150_000


def press(n: int, *, picture: bytes | None = b"\x89PNG", **outcome: Any) -> list[Message]:
    press_id = new_ulid(T0_NS + n, lambda k: n.to_bytes(k, "big"))
    fields = {"verdict": Kind.PASS, "score": 0.5, "threshold": 1.0, "score_ratio": 0.5, **outcome}
    result = ResultPayload(
        time_ns=T0_NS + n * 10**9,
        press_id=press_id,
        part=fields.pop("part", "bolt"),
        sensor_serial="S",
        gel_id="S-1",
        gel_presses=n,
        gel_limit_presses=1000,
        **fields,
    )
    pictures = [] if picture is None else [heatmap_message(press_id, picture)]
    return [Message("result", result.encode()), *pictures]


def gel(presses: int, state: GelState) -> Message:
    fields = {"sensor_serial": "S", "gel_id": "S-1", "limit_presses": 1000}
    return gel_message(GelPayload(time_ns=T0_NS, presses=presses, state=state, **fields))


@pytest.fixture
def sink() -> Iterator[PageSink]:
    """At a free port."""
    opened = PageSink(0, Station(ROOT, "press2"))
    yield opened
    opened.close()


def ask(sink: PageSink, path: str, method: str = "GET", host: str | None = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", sink.port, timeout=20)
    connection.request(method, path, headers={"Host": host or f"127.0.0.1:{sink.port}"})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def asked(sink: PageSink, path: str) -> Any:
    return json.loads(ask(sink, path)[1])


def test_it_shows_the_newest_of_everything(sink: PageSink) -> None:
    """State, gel and alarms as they are now; an alarm that is over is gone."""
    for message in (
        state_message(StatePayload(time_ns=T0_NS, state="starting")),
        state_message(StatePayload(time_ns=T0_NS, state="ready")),
        alarm_message(AlarmPayload(time_ns=T0_NS, alarm="gel", text="the gel is due")),
        alarm_message(AlarmPayload(time_ns=T0_NS, alarm="disk", text="little room")),
        alarm_cleared("disk"),
        gel(801, GelState.DUE),
    ):
        sink.send(message)

    station = asked(sink, "/station.json")

    assert station["place"] == "plant/line1/press2"
    assert station["state"]["state"] == "ready"
    assert [alarm["text"] for alarm in station["alarms"].values()] == ["the gel is due"]
    assert station["gel"]["presses"] == 801


def test_presses_are_newest_first_each_with_its_picture(sink: PageSink) -> None:
    """A press without a picture says so."""
    for message in (*press(1), *press(2, picture=None), *press(3, picture=b"\x89PNG3")):
        sink.send(message)

    presses = asked(sink, "/presses.json")

    assert [(one["gel_presses"], one["has_picture"]) for one in presses] == [(3, True), (2, False), (1, True)]
    assert ask(sink, f"/pictures/{presses[0]['press_id']}.png") == (200, b"\x89PNG3")
    assert ask(sink, f"/pictures/{presses[1]['press_id']}.png")[0] == 404


def test_what_it_keeps_is_bounded(sink: PageSink) -> None:
    """The newest results, and the pictures of fewer."""
    for n in range(1, MOST_PRESSES + 20):
        for message in press(n):
            sink.send(message)

    presses = asked(sink, "/presses.json")

    assert len(presses) == MOST_PRESSES
    assert [one["has_picture"] for one in presses] == [n < MOST_PICTURES for n in range(MOST_PRESSES)]


@pytest.mark.parametrize(
    "path", ["/other", "/../page.py", "/pictures/../page.html", "/pictures/", "/page.html"]
)
def test_there_are_no_other_pages(sink: PageSink, path: str) -> None:
    """Files of the machine least of all."""
    assert ask(sink, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_can_be_changed(sink: PageSink, method: str) -> None:
    """It only reads."""
    assert ask(sink, "/station.json", method)[0] == 501


@pytest.mark.parametrize("host", ["plant.example", "plant.example:8080", "localhost.example", ""])
def test_a_page_of_others_cannot_read_it(sink: PageSink, host: str) -> None:
    """A browser sends the name that it was given: one that is not this machine's is refused."""
    assert ask(sink, "/presses.json", host=host or " ")[0] == 403


def test_only_this_machine_reaches_it(sink: PageSink) -> None:
    """It listens on the loopback address alone."""
    assert sink._server.server_address[0] == "127.0.0.1"
    assert ask(sink, "/", host="localhost")[0] == 200


def test_what_cannot_be_shown_is_refused_and_ends_nothing(sink: PageSink) -> None:
    """No JSON, or no object; pictures and topics that it does not show are done at once."""
    for payload in (b"[", b"[1]", b"\xff"):
        with pytest.raises(SinkRejected, match="cannot be shown"):
            sink.send(Message("result", payload))
    for message in (Message("last", b"["), Message("availability", b"online"), Message("asyncapi", b"{}")):
        sink.send(message)

    assert ask(sink, "/presses.json") == (200, b"[]")


def test_a_port_that_is_taken_is_a_refusal() -> None:
    """At the start, with the port and what to do."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])
        with pytest.raises(ConfigError, match=f"127.0.0.1:{port}: .*choose another port"):
            plugin.open(PageOptions(port=port), Station(ROOT, "press2"))


def test_after_the_end_it_is_gone(sink: PageSink) -> None:
    """And may be closed again."""
    sink.close()
    sink.close()

    with pytest.raises(ConnectionRefusedError):
        ask(sink, "/")


def test_the_page_is_small_and_loads_nothing_from_elsewhere(sink: PageSink) -> None:
    """Three files, without a network."""
    parts = [ask(sink, path)[1] for path in ("/", "/page.css", "/page.js")]

    assert 3000 < sum(map(len, parts)) < LARGEST_PAGE_BYTES
    assert b"http" not in b"".join(parts).replace(b"http-equiv", b"")


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
        state_message(StatePayload(time_ns=T0_NS, state="ready")),
        gel(801, GelState.DUE),
        alarm_message(AlarmPayload(time_ns=T0_NS, alarm="gel", text="gel S-1 is due", severity="warning")),
        stats_message(
            StatsPayload(
                time_ns=1,
                uptime_s=1,
                frames=1,
                frames_corrupt=0,
                delivered_fps=18,
                presses=2,
                receivers={"mqtt": "no broker answers"},
            )
        ),
        *press(1),
        *press(2, verdict=Kind.FAIL, score=2.5, score_ratio=2.5, part="<b>bolt</b>", picture=PICTURE),
    ):
        sink.send(message)

    tab.wait_for_selector("#verdict.fail")
    assert tab.inner_text("#verdict").lower() == "fail"
    assert "<b>bolt</b>" in tab.inner_text("#facts")
    assert "2.50 × threshold" in tab.inner_text("#facts")
    assert tab.inner_text("#alarms").strip() == "gel S-1 is due"
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
