"""The sink `page`: what it serves, and to whom."""

import http.client
import json
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from typing import Any

import numpy as np
import pytest
from page_messages import ROOT, T0_NS, ask, asked, gel, info, press, reference, state, stats
from waiting import wait_until

from edge.clock import ManualClock
from edge.core.errors import SinkRejected
from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.core.verdict import Kind
from edge.messaging.alarm_payload import ALARMS, AlarmPayload, alarm_cleared
from edge.messaging.payload_base import as_replayed
from edge.messaging.status_payloads import Question, QuestionsPayload
from edge.page.http_server import MOST_OF_ONE, REQUEST_S, HttpHandler, HttpServer
from edge.page.shown import MOST_ASKED, MOST_PICTURES, MOST_PRESSES
from edge.pictures.image_file import encode, encode_jpeg
from plugins.sinks.page import PageOptions, PageSink, plugin


def test_it_shows_the_newest_of_everything(sink: PageSink) -> None:
    """As JSON, for programs too, under the name of the topic; null for what has not come yet. An alarm that is over is
    gone."""
    assert asked(sink.port, "/state.json") is None
    for message in (
        *(state("starting"), state("ready"), info(), gel(801, GelState.DUE), stats(mqtt="up"), reference()),
        AlarmPayload(time_ns=T0_NS, alarm="gel", text="the gel is due").message(),
        AlarmPayload(time_ns=T0_NS, alarm="disk", text="little room").message(),
        alarm_cleared("disk"),
        *press(1),
    ):
        sink.send(message)
    station = asked(sink.port, "/station.json")

    assert station["place"] == "plant/line1/press2"
    assert station["state"]["state"] == asked(sink.port, "/state.json")["state"] == "ready"
    assert asked(sink.port, "/alarms.json") == station["alarms"]
    assert {name: alarm["text"] for name, alarm in station["alarms"].items()} == {"gel": "the gel is due"}
    assert station["alarms"]["gel"]["what_to_do"] == ALARMS["gel"].what_to_do
    assert asked(sink.port, "/gel.json")["presses"] == station["gel"]["presses"] == 801
    assert asked(sink.port, "/reference.json")["charts"][0]["measure"] == "score"
    assert asked(sink.port, "/info.json")["parts"] == ["bolt/pos1", "nut/pos1"]
    assert asked(sink.port, "/stats.json")["receivers"] == {"mqtt": "up"}
    assert station | {"presses": asked(sink.port, "/presses.json")} == asked(sink.port, "/live.json")


def test_presses_are_newest_first_each_with_its_picture(sink: PageSink) -> None:
    """What it keeps is bounded: the newest results, and the pictures of fewer. A press without a picture says so."""
    for n in range(1, MOST_PRESSES + 20):
        for message in press(n, picture=None if n == MOST_PRESSES else b"\x89PNG\r\n\x1a\n%d" % n):
            sink.send(message)
    presses = asked(sink.port, "/presses.json")

    assert [one["gel_presses"] for one in presses] == list(range(MOST_PRESSES + 19, 19, -1))
    pictured = [n for n, one in enumerate(presses) if one["has_picture"]]
    assert (len(pictured), 19 in pictured) == (MOST_PICTURES, False)
    assert ask(sink.port, f"/pictures/{presses[0]['press_id']}") == (
        200,
        b"\x89PNG\r\n\x1a\n%d" % (MOST_PRESSES + 19),
    )
    assert ask(sink.port, f"/pictures/{presses[19]['press_id']}")[0] == 404


def test_late_pictures_take_no_newer_one_away(sink: PageSink) -> None:
    """After an interruption the pictures of many older presses come behind the newest one's."""
    *results, newest = [press(n) for n in range(1, 2 * MOST_PICTURES)]
    for message in [
        *(result for result, *_ in results),
        *newest,
        *(late for _, *all_late in results for late in all_late),
    ]:
        sink.send(message)

    pictured = [one["has_picture"] for one in asked(sink.port, "/presses.json")]
    assert pictured == [True] * MOST_PICTURES + [False] * (MOST_PICTURES - 1)


def test_a_picture_may_come_before_its_result(sink: PageSink) -> None:
    """As from a broker after an interruption, when as many pictures as are kept are there already."""
    earlier = [message for n in range(1, MOST_PICTURES + 1) for message in press(n)]
    for message in [*earlier, *reversed(press(MOST_PICTURES + 1))]:
        sink.send(message)
    assert asked(sink.port, "/presses.json")[0]["has_picture"]


def test_pictures_that_a_person_is_asked_about_are_kept_longer(sink: PageSink) -> None:
    """Of the first ones of a list; a broker that asks about every press fills no memory."""
    pressed = [press(n) for n in range(1, MOST_ASKED + 2 * MOST_PICTURES)]
    ids = [json.loads(messages[0].payload)["press_id"] for messages in pressed]
    values = {"time_ns": 1, "time_ms": 0, "verdict": "pass", "score_ratio": 0.9, "part": "bolt"}
    asked_now = tuple(Question(press_id=one, **values) for one in ids[: MOST_ASKED + 1])
    sink.send(QuestionsPayload(time_ns=T0_NS, per_day=100, presses=asked_now).message())
    for messages in pressed:
        for message in messages:
            sink.send(message)

    assert len(asked(sink.port, "/questions.json")["presses"]) == MOST_ASKED + 1
    assert asked(sink.port, "/station.json")["pictures"] == ids[:MOST_ASKED] + ids[-MOST_PICTURES:]


def test_the_picture_of_a_press_that_was_asked_about_before_the_start_is_drawn_again() -> None:
    """Once, when somebody looks; of one that is too large, or gone from the archive, the page says so, and no other is
    drawn."""
    drawn, ids = list[str](), [json.loads(press(n)[0].payload)["press_id"] for n in (1, 2, 3, 4)]

    def draw(press_id: str) -> bytes:
        drawn.append(press_id)
        pictures = {ids[0]: encode_jpeg(np.zeros((4, 4, 3), np.uint8), {}), ids[1]: bytes(5 << 20)}
        return pictures.get(press_id, b"")

    questions = tuple(
        Question(press_id=one, time_ns=1, time_ms=0, verdict="pass", score_ratio=0.9, part="bolt")
        for one in ids[:3]
    )
    with closing(PageSink(PageOptions(), Station(ROOT, "press2", draw=draw), ManualClock(), port=0)) as sink:
        sink.send(QuestionsPayload(time_ns=T0_NS, per_day=10, presses=questions).message())
        assert asked(sink.port, "/station.json")["pictures"] == ids[:3]
        answers = [ask(sink.port, f"/pictures/{one}")[0] for one in (*ids, *ids)]

        assert answers == [200, 404, 404, 404] * 2
        assert drawn == ids[:3]
        assert asked(sink.port, "/station.json")["pictures"] == ids[:1]


def test_presses_of_before_the_start_are_listed_and_drawn_when_somebody_looks() -> None:
    """They are marked, so that none is taken for the newest; one of them that comes late takes its place."""
    ids = [json.loads(press(n)[0].payload)["press_id"] for n in (1, 2, 3)]
    before = [
        {"press_id": one, "sequence": n, "time_ns": T0_NS, "verdict": "pass"}
        for n, one in enumerate(ids[:2], 1)
    ]
    picture = encode_jpeg(np.zeros((4, 4, 3), np.uint8), {})
    pictures = {ids[1]: picture, ids[2]: picture}
    station = Station(
        ROOT, "press2", draw=lambda one: pictures.get(one, b""), earlier=lambda most: before[-most:]
    )
    with closing(PageSink(PageOptions(), station, ManualClock(), port=0)) as sink:
        sink.send(reference())
        assert [ask(sink.port, f"/pictures/{one}")[0] for one in ids] == [404, 200, 404]
        for n in (3, 1):
            for message in press(n):
                sink.send(message)

        shown = asked(sink.port, "/presses.json")

    assert [one["press_id"] for one in shown] == [ids[2], ids[1], ids[0]]
    assert [one.get("is_earlier", False) for one in shown] == [False, True, True]
    assert [one["has_picture"] for one in shown] == [True, True, True]


def test_no_verdict_of_before_an_interruption_is_that_of_now(sink: PageSink) -> None:
    """As lights forget it: meanwhile another part may have been put there."""

    def find_earlier(*messages: Message) -> list[bool]:
        for message in messages:
            sink.send(message)
        return [one.get("is_earlier", False) for one in asked(sink.port, "/presses.json")]

    assert find_earlier(state("starting"), state("ready"), *press(1)) == [False]
    assert find_earlier(state("ready", "another reason")) == [False]
    assert find_earlier(state("halted", "unplugged")) == [False]  # a pass is not shown, a fail stays
    assert find_earlier(state("ready")) == [True]
    assert find_earlier(press(1)[0]) == [True]
    assert find_earlier(*press(2)) == [False, True]
    contact = AlarmPayload(time_ns=T0_NS, alarm="contact", text="it is pressed").message()
    assert find_earlier(contact, alarm_cleared("contact")) == [True, True]
    failed = press(3, verdict=Kind.FAIL, score=2.5, score_ratio=2.5)
    assert find_earlier(*failed, contact) == [False, True, True]
    assert find_earlier(as_replayed(press(4)[0])) == [True] * 4


def test_a_pass_is_not_that_of_a_master_piece(sink: PageSink) -> None:
    """It has no result, and whoever has pressed a part in its place must not take the pass before for that part's."""

    def find_earlier(*messages: Message) -> list[bool]:
        for message in messages:
            sink.send(message)
        return [one.get("is_earlier", False) for one in asked(sink.port, "/presses.json")]

    assert find_earlier(state("ready"), *press(1)) == [False]
    of_other_gel, here = reference(), {"sensor_serial": "S", "gel_id": "S-1"}
    assert find_earlier(of_other_gel) == [False]  # by its time it is old
    second = reference(**here, gel_presses=2)
    assert find_earlier(second) == [True]
    assert find_earlier(*press(3)) == [False, True]
    assert find_earlier(second) == [False, True]  # as after an interruption
    assert find_earlier(reference(**here, gel_presses=5), press(4)[0]) == [True] * 3  # it comes too late
    failed = press(6, verdict=Kind.FAIL, score=2.5, score_ratio=2.5)
    assert find_earlier(*failed, reference(**here, gel_presses=7)) == [False, True, True, True]


@pytest.mark.parametrize(
    ("path", "method", "host", "status"),
    [
        *((path, "GET", "localhost", 404) for path in ("/other", "/../page.py", "/pictures/../page.html")),
        *((path, "GET", "localhost", 404) for path in ("/pictures/", "/page.html")),
        # OPTIONS least of all: it is the question whether another page may ask.
        *(("/requests/x", method, "localhost", 501) for method in ("PUT", "DELETE", "OPTIONS", "TRACE")),
        # A browser sends the name that it was given.
        *(("/presses.json", "GET", host, 403) for host in ("plant.example:8080", "localhost.example", "")),
        ("/", "GET", "localhost", 200),
    ],
)
def test_nothing_else_is_served(sink: PageSink, path: str, method: str, host: str, status: int) -> None:
    """No file of the machine, no other method, and nothing to a page of others."""
    assert ask(sink.port, path, method, Host=host)[0] == status


def test_a_browser_that_waits_is_answered_when_something_comes(sink: PageSink) -> None:
    """And at once where it has missed something."""
    version = asked(sink.port, "/live.json")["version"]
    with ThreadPoolExecutor() as pool:
        waiting = pool.submit(asked, sink.port, f"/live.json?after={version}")
        sink.send(state("ready"))
        assert waiting.result(60)["state"]["state"] == "ready"
    assert asked(sink.port, f"/live.json?after={version}")["version"] == version + 1
    assert asked(sink.port, "/live.json?after=x")["version"] == version + 1


@pytest.mark.parametrize("write", [encode, encode_jpeg])
def test_the_newest_picture_is_found_by_the_id_inside(
    sink: PageSink, write: Callable[[np.ndarray, dict[str, str]], bytes]
) -> None:
    """A page that was opened after the press has it from the retained topic; one that names no press is left."""
    newest = press(1, picture=None)[0]
    press_id = json.loads(newest.payload)["press_id"]
    pixels = write(np.zeros((2, 2, 3), np.uint8), {"press_id": press_id})
    sink.send(Message("last/press", newest.payload))
    sink.send(Message("last/heatmap", pixels))
    sink.send(Message("last/heatmap", b""))

    assert [one["has_picture"] for one in asked(sink.port, "/presses.json")] == [True]
    assert ask(sink.port, f"/pictures/{press_id}") == (200, pixels)


def test_only_this_machine_reaches_it(sink: PageSink) -> None:
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", sink.port), timeout=60)


def own_address() -> str:
    """Of this machine in a network; no packet is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            pytest.skip("SKIPPED, NOT TESTED: this machine has no network")
        return str(probe.getsockname()[0])


def test_another_machine_sees_it_where_it_is_named() -> None:
    """By its address; a refusal says where to name it, and the page does not get into it."""
    address = own_address()
    for allowed, status in (("203.0.113.77", 403), (address, 200)):
        options = PageOptions(bind="0.0.0.0", allow_from=(allowed,))
        sink = PageSink(options, Station(ROOT, "press2"), ManualClock(), port=0)
        connection = http.client.HTTPConnection(address, sink.port, timeout=60)
        connection.request("GET", "/state.json")
        answer = connection.getresponse()
        said = answer.read().decode()
        connection.close()
        sink.close()

        assert answer.status == status
        assert said == "null" if status == 200 else f"not shown to {address}; name its address" in said


@pytest.mark.parametrize("path", ["/", "/station.json", "/other"])
def test_every_answer_forbids_what_the_page_does_not_need(sink: PageSink, path: str) -> None:
    """Scripts and frames of others, a guess at the type, a copy in a cache, and the name of the server's language."""
    connection = http.client.HTTPConnection("127.0.0.1", sink.port, timeout=60)
    connection.request("GET", path)
    headers = connection.getresponse().headers
    connection.close()

    assert headers["Content-Security-Policy"].startswith("default-src 'self';")
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Cache-Control"] == "no-store"
    assert headers["Server"].strip() == "gelgate"


def test_what_cannot_be_shown_is_refused_and_ends_nothing(sink: PageSink) -> None:
    """No JSON, or no object; pictures and topics that it does not show are done at once."""
    for payload in (b"[", b"[1]", b"\xff"):
        with pytest.raises(SinkRejected, match="cannot be shown"):
            sink.send(Message("result", payload))
    for message in (Message("last", b"["), Message("availability", b"online"), Message("asyncapi", b"{}")):
        sink.send(message)

    assert ask(sink.port, "/presses.json") == (200, b"[]")


def test_a_port_that_is_taken_stops_no_station() -> None:
    """`check` warns, the alarm `receiver` says what to do, and the page is served once the port is free."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        options = PageOptions(port=int(taken.getsockname()[1]))
        with closing(plugin.open(options, Station(ROOT, "press2"))) as sink:
            sink.send(state("ready"))
            (fault,) = sink.faults
            assert f"127.0.0.1:{options.port}: Address already in use; choose another port" in fault
            (warning,) = options.warnings()
            assert f"127.0.0.1:{options.port} cannot be served now (Address already in use)" in warning

            taken.close()
            assert options.warnings() == []
            sink.send(stats(mqtt="up"))

            assert (sink.port, sink.faults) == (options.port, ())
            assert asked(sink.port, "/state.json")["state"] == "ready"


def test_a_connection_that_a_browser_keeps_open_ends_with_the_page(sink: PageSink) -> None:
    """Otherwise it would be answered for ever; a page that waits for news on it is answered, and sees the end."""
    request = b"GET /state.json HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with socket.create_connection(("127.0.0.1", sink.port), timeout=60) as kept:
        answer = b""
        kept.sendall(request)
        while not answer.endswith(b"null"):
            answer += kept.recv(65536)
        sink.close()

        with suppress(ConnectionError):
            kept.sendall(request)
            assert kept.recv(65536) == b""
    sink.close()
    with pytest.raises(ConnectionRefusedError):
        ask(sink.port, "/")


def connected(port: int, sent: bytes = b"") -> socket.socket:
    """A client that sends this, and nothing more."""
    client = socket.create_connection(("127.0.0.1", port), timeout=60)
    client.sendall(sent)
    return client


def rest(client: socket.socket) -> bytes:
    """What comes until the page ends the connection."""
    with client, suppress(ConnectionError):
        return b"".join(iter(lambda: client.recv(65536), b""))
    return b""


def opened(sink: PageSink) -> list[Any]:
    """The connections of the server, as they are now."""
    return list(sink._server._server._open.copy().values())


WHOLE = b"GET /station.json HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
WAITING = b"GET /live.json?after=1 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"


def test_slow_clients_shut_nobody_out(sink: PageSink) -> None:
    """One more takes the place of the one that has waited longest for its request, which has no answer."""
    slow = [connected(sink.port, WHOLE[:20]) for _ in range(MOST_OF_ONE)]

    assert [ask(sink.port, "/station.json")[0] for _ in range(3)] == [200] * 3
    assert rest(slow[0]) == b""
    slow[-1].sendall(WHOLE[20:])
    assert rest(slow[-1]).startswith(b"HTTP/1.1 200")
    for client in slow:
        client.close()


def test_connections_are_bounded(sink: PageSink) -> None:
    """Where all are answered, one too many is closed at once, without an answer; there is room again when one ends."""
    asking = [connected(sink.port, WAITING) for _ in range(MOST_OF_ONE)]
    wait_until(lambda: sum(one.due_ns is None for one in opened(sink)) == MOST_OF_ONE)

    one_more = connected(sink.port)
    with suppress(ConnectionError):
        one_more.sendall(WHOLE)
    assert rest(one_more) == b""

    sink.send(state("ready"))
    assert all(rest(client).startswith(b"HTTP/1.1 200") for client in asking)
    assert ask(sink.port, "/station.json")[0] == 200


@pytest.mark.parametrize(
    "sent", [WHOLE[:20], b"POST /requests/x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n{"]
)
def test_a_request_that_takes_too_long_is_left(sink: PageSink, clock: ManualClock, sent: bytes) -> None:
    """As a whole, with its body: a byte now and then does not keep it."""
    slow = connected(sink.port, sent)
    slow.settimeout(REQUEST_S / 2)  # below the silence after which the server leaves anybody
    wait_until(lambda: len(opened(sink)) == 1)
    for _ in range(2):
        clock.sleep(REQUEST_S / 2 - 1)
        slow.sendall(b" ")
    clock.sleep(2)

    assert b"200" not in rest(slow)


@pytest.mark.parametrize(
    ("request_line", "headers", "words"),
    [
        ("POST /requests/x", "Content-Length: \u00b2", "one whole number of bytes"),
        ("POST /requests/x", "Content-Length: +2", "one whole number of bytes"),
        ("POST /requests/x", "Content-Length: 2\r\nContent-Length: 2", "one whole number of bytes"),
        ("POST /requests/x", "Content-Length: 2\r\nTransfer-Encoding: chunked", "read in two ways"),
        ("POST /requests/x", "Accept : x\r\nContent-Length: 2", "read in two ways"),
        ("GET /station.json", "Host: localhost", "read in two ways"),
        ("GET /station.json", "Content-Length: 73", "a request with GET has no body"),
        ("GET http://localhost/station.json", "Accept: x", "names a path that begins with '/'"),
    ],
)
def test_what_proxies_misread_is_refused(sink: PageSink, request_line: str, headers: str, words: str) -> None:
    """With 400, and the connection ends: what follows is no second request."""
    sent = f"{request_line} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n\r\n".encode("latin-1")
    answer = rest(connected(sink.port, sent + WHOLE))

    assert answer.startswith(b"HTTP/1.1 400")
    assert words in answer.decode()
    assert answer.count(b"HTTP/1.1") == 1


def test_a_fault_of_the_page_is_in_the_log(
    sink: PageSink, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its connection ends without an answer; that of a browser that goes away is no fault."""
    monkeypatch.setattr(sink._shown, "presses", lambda: 1 / 0)
    with connected(sink.port, b"GET /presses.json HTTP/1.1\r\nHost: localhost\r\n\r\n") as client:
        assert rest(client) == b""
    assert "a request of 127.0.0.1 is not answered; its connection is ended" in caplog.text
    assert "ZeroDivisionError" in caplog.text


def test_a_burst_of_connections_waits_for_a_loaded_gateway() -> None:
    """Before one is accepted all are made, so that they are accepted in their order."""
    with HttpServer(("127.0.0.1", 0), HttpHandler, ManualClock()) as server, ExitStack() as opened:
        for _ in range(MOST_OF_ONE + 1):
            opened.enter_context(socket.create_connection(server.server_address, timeout=10))
