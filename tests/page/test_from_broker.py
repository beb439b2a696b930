"""The page of a station at a broker: the same JSON, also while the broker is away; changes go there, signed."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from page_messages import ROOT, T0_NS, TOKEN, ask, asked, contact, gel, press, state
from ports import free_port
from waiting import wait_until

from edge.cli.page import page
from edge.clock import ManualClock, SystemClock
from edge.core.errors import ConfigError, GelgateError
from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.gateway.commands import Change, CommandPolicy, Commands
from edge.messaging.alarm_payload import AlarmPayload, alarm_cleared
from edge.messaging.command_payloads import CommandResponse
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker, Received
from edge.messaging.mqtt_connection import Connection
from edge.page.from_broker import BrokerStation, page_requests
from edge.page.server import PageServer
from edge.page.settings import PageSettings
from edge.store.press_store import Store
from plugins.sinks.mqtt import MqttSink, plugin
from plugins.sinks.mqtt_options import MqttOptions

GELGATE = Path(sys.executable).parent / "gelgate"
SECRET = b"0123456789abcdef"
ALL = "gelgate/+/+/+/gel/v1/#"


def says(broker: LocalBroker, *messages: Message, root: str = ROOT) -> None:
    connection = Connection.open(Broker(broker.host, broker.port, "says", level="5", timeout_s=60.0))
    for one in messages:
        connection.publish(Message(f"{root}/{one.topic}", one.payload, 1, one.retain))
    connection.close()


def listening(broker: LocalBroker, opened: ExitStack, topic_filter: str = ALL) -> BrokerStation:
    station = BrokerStation(Broker(broker.host, broker.port, "page"), topic_filter)
    opened.callback(station.close)
    station.start()
    return station


def test_it_shows_what_the_broker_has_and_what_comes(mosquitto: LocalBroker) -> None:
    """The retained messages first: state, gel, alarms and the newest press; its place is in the topic. While the
    broker is away it says so; an alarm that ended is gone, the presses stay."""
    raised = AlarmPayload(time_ns=T0_NS, alarm="gel", text="the gel is due").message()
    newest = Message("last/press", press(1, picture=None)[0].payload, retain=True)
    says(mosquitto, state("ready"), gel(801, GelState.DUE), raised, newest)
    with ExitStack() as opened:
        shown = listening(mosquitto, opened).shown
        wait_until(lambda: shown.presses())
        says(mosquitto, *press(2))
        wait_until(lambda: len(shown.presses()) == 2 and shown.presses()[0]["has_picture"])
        station = shown.station()
        assert (station["place"], station["away"]) == ("plant/line1/press2", None)
        assert (station["state"]["state"], station["gel"]["presses"]) == ("ready", 801)
        assert list(station["alarms"]) == ["gel"]
        says(mosquitto, alarm_cleared("gel"))
        wait_until(lambda: not shown.station()["alarms"])
        says(mosquitto, raised)
        wait_until(lambda: shown.station()["alarms"])

        mosquitto.stop()
        wait_until(lambda: "trying again" in (shown.station()["away"] or ""))
        assert shown.station()["state"]["state"] == "ready"
        mosquitto.start()
        wait_until(lambda: "has no message of a station" in (shown.station()["away"] or ""))
        says(mosquitto, state("ready"))
        wait_until(lambda: shown.station()["away"] is None)
        assert shown.station()["alarms"] == {}
        assert len(shown.presses()) == 2


def test_a_station_that_falls_silent_is_away(mosquitto: LocalBroker, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a frozen gateway, or behind a network that closes nothing: the last pass is not that of now. One that has
    ended says why it is silent, and what is retained is no sign of life."""
    monkeypatch.setattr("edge.page.from_broker.SILENT_S", 0.3)
    with ExitStack() as opened:
        says(mosquitto, state("ready"), contact("free"))
        shown = listening(mosquitto, opened).shown
        wait_until(lambda: shown.station()["contact"])
        time.sleep(0.5)
        assert shown.station()["away"] is None
        says(mosquitto, contact("free"), *press(1))
        wait_until(lambda: "nothing has come from the station" in (shown.station()["away"] or ""))
        says(mosquitto, contact("touching"))
        wait_until(lambda: shown.station()["away"] is None)
        says(mosquitto, contact("free"), state("stopped"))
        wait_until(lambda: shown.station()["state"]["state"] == "stopped")
        time.sleep(0.5)
        assert shown.station()["away"] is None


def test_a_broker_that_is_away_at_the_start_is_waited_for() -> None:
    """The page is there, and says so."""
    with ExitStack() as opened:
        station = BrokerStation(Broker("127.0.0.1", free_port(), "page"), ALL)
        opened.callback(station.close)
        assert "no connection to broker 127.0.0.1:" in station.shown.station()["away"]
        station.start()
        wait_until(lambda: "trying again" in station.shown.station()["away"])


def unheard() -> BrokerStation:
    return BrokerStation(Broker("127.0.0.1", 1, "page"), ALL)


def test_one_station_is_shown_and_others_are_named(caplog: pytest.LogCaptureFixture) -> None:
    """The first; the log says once how to choose another."""
    station = unheard()
    for root in (ROOT, ROOT.replace("press2", "press3"), ROOT.replace("press2", "press3")):
        station.see(Received(f"{root}/state", state("ready").payload, 1, True))
        station.see(Received(f"{root}/state", state("halted", root).payload, 1, True))

    assert station.shown.station()["place"] == "plant/line1/press2"
    assert station.shown.station()["state"]["reason"] == ROOT
    assert caplog.text.count("are left out: name the one with --site, --line and --station") == 1


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        (f"{ROOT}/state", b"{"),
        (f"{ROOT}/state", b"[" * 50_000),
        (f"{ROOT}/state", re.sub(rb'"time_ns":\d+', b'"time_ns":1' + b"0" * 300, state("halted").payload)),
        (f"{ROOT}/result", b'{"press_id":"<script>"}'),
        (f"{ROOT}/heatmap/../../x", b"\x89PNG"),
        (f"{ROOT}/last/heatmap", b"GIF"),
        (f"{ROOT}/last/heatmap", b"\xff\xd8\xff\xfe\xc3\x52" + b"[" * 50_000),
        (f"{ROOT}/last/heatmap", b"\x89PNG\r\n\x1a\n\0\0\0\x01iTXtx\0\0\0\0"),
        (f"{ROOT}/alarm/gel", b"\xff"),
        (f"{ROOT}/cmd/select_part/response", b"[" * 50_000),
        (f"{ROOT}/cmd/select_part/response", b"[]"),
        (f"{ROOT}/cmd/select_part/response", b'{"transaction":{}}'),
        (f"{ROOT}/cmd/select_part", b'{"transaction":"1"}'),
        ("gelgate/x", b"{}"),
        ("/gel/v1/state", b"{}"),
    ],
)
def test_a_malformed_message_ends_nothing_and_is_not_shown(topic: str, payload: bytes) -> None:
    """Anybody may publish at a broker."""
    station = unheard()
    station.see(Received(f"{ROOT}/state", state("ready").payload, 1, True))
    before = station.shown.station()
    station.see(Received(topic, payload, 1, False))

    assert station.shown.station() == before
    assert station.shown.presses() == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_page_that_listens_no_more_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would look as if nothing happened at the station."""
    station = unheard()
    monkeypatch.setattr(station, "listen", lambda: 1 / 0)
    station.start()
    wait_until(lambda: "listens no more" in station.shown.station()["away"])
    station.close()


@pytest.fixture
def served(
    mosquitto: LocalBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., tuple[int, Store]]]:
    """A station at the broker that serves signed requests, and its page here with this secret; gives port and store."""
    monkeypatch.setenv("PAGE_TOKEN", TOKEN)
    with ExitStack() as opened:
        clock = ManualClock(time.time_ns())
        store = opened.enter_context(Store(tmp_path / "gelgate.db", monotonic_ns=clock.monotonic_ns))
        policy = CommandPolicy(ROOT, frozenset(), frozenset({"select_part"}), SECRET)
        handlers = {"select_part": lambda asked: Change({"part": asked["name"]}), "replace_gel": None}
        commands = Commands(handlers, policy, store, clock)  # type: ignore[arg-type]
        opened.callback(sink_of(mosquitto, commands).close)

        def serve(secret: bytes = SECRET) -> tuple[int, Store]:
            station = listening(mosquitto, opened)
            wait_until(lambda: station.shown.station()["away"] is None)
            here = SystemClock()
            settings = PageSettings(token_variable="PAGE_TOKEN")
            server = PageServer(station.shown, settings, page_requests(station, secret, here), here, port=0)
            opened.callback(server.close)
            return server.port, store

        yield serve


def sink_of(broker: LocalBroker, commands: Commands) -> MqttSink:
    station = Station(ROOT, "press2", birth=lambda: [state("ready")], on_command=commands)
    return plugin.open(MqttOptions(host=broker.host, port=broker.port, retry_s=1), station)


def post(port: int, verb: str, token: str = TOKEN, **more: Any) -> tuple[int, dict[str, Any]]:
    body = json.dumps({"transaction": "1", **more}).encode()
    status, answer = ask(port, f"/requests/{verb}", "POST", body, Authorization=f"Bearer {token}")
    return status, json.loads(answer)


def test_a_change_is_signed_for_the_station(
    served: Callable[..., tuple[int, Store]], caplog: pytest.LogCaptureFixture
) -> None:
    """It is done there, and its table of acts names the person. A wrong token does not reach the station: it is a
    sentence on the page and a line in the log here. What the station does not serve is its answer."""
    port, store = served()
    wrong_status, wrong = post(port, "select_part", "guess-guess")
    assert (wrong_status, wrong["error"]) == (401, "this is not the token of this page")
    assert "command 'select_part' was refused at the page" in caplog.text
    assert store.acts() == []

    status, answer = post(port, "select_part", by="kim", arguments={"name": "PZ1/pos1"})
    assert (status, answer["status"], answer["data"]) == (200, "ok", {"part": "PZ1/pos1"})
    (act,) = store.acts()
    assert (act.who, act.verb, act.outcome) == ("kim, at a page, over MQTT, signed", "select_part", "done")
    assert "is off at this station" in post(port, "replace_gel")[1]["error"]


def test_a_wrong_secret_is_refused_by_the_station(served: Callable[..., tuple[int, Store]]) -> None:
    """With its sentence, and a row there."""
    port, store = served(b"another-secret-16")
    answer = post(port, "select_part", arguments={"name": "PZ1/pos1"})[1]

    assert answer["error"] == "the signature is not that of this request and this station's secret"
    assert [act.outcome for act in store.acts()] == ["refused"]


def test_a_station_that_does_not_answer_is_a_sentence(mosquitto: LocalBroker) -> None:
    """It may have been done: the table of acts there says so."""
    says(mosquitto, state("lost"))
    with ExitStack() as opened:
        station = BrokerStation(Broker(mosquitto.host, mosquitto.port, "page"), ALL, answer_s=0.2)
        opened.callback(station.close)
        station.start()
        wait_until(lambda: station.shown.station()["away"] is None)
        with pytest.raises(GelgateError, match=r"did not answer within 0.2 s; `gelgate station acts` there"):
            station.ask("select_part", b'{"transaction":"1"}')


def test_a_request_that_is_sent_twice_is_answered_twice(mosquitto: LocalBroker) -> None:
    """A browser may repeat it while the first waits; the station does it once."""
    says(mosquitto, state("ready"))
    with ExitStack() as opened:
        station = listening(mosquitto, opened)
        heard: list[Received] = []
        there = Connection.open(Broker(mosquitto.host, mosquitto.port, "there"), on_received=heard.append)
        opened.callback(there.close)
        there.subscribe(f"{ROOT}/cmd/select_part")
        wait_until(lambda: station.shown.station()["away"] is None)
        pool = opened.enter_context(ThreadPoolExecutor())
        both = [pool.submit(station.ask, "select_part", b'{"transaction":"1"}') for _ in range(2)]
        wait_until(lambda: len(heard) == 2)
        answer = CommandResponse(time_ns=1, transaction="1", verb="select_part", status="ok", error=None)
        says(mosquitto, Message("cmd/select_part/response", answer.encode()))
        assert [json.loads(one.result(20))["transaction"] for one in both] == ["1", "1"]


def test_nothing_is_asked_while_the_broker_is_away() -> None:
    """The sentence says why."""
    answer = page_requests(unheard(), SECRET, ManualClock()).do("select_part", b'{"transaction":"1"}')
    assert "nothing was asked: no connection to broker 127.0.0.1:1 yet" in json.loads(answer)["error"]


def test_the_page_signs_what_it_has_buttons_for_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who has its token has not the station's secret, which opens every signed verb there."""
    station, signed = unheard(), list[str]()

    def ask(verb: str, payload: bytes) -> bytes:
        signed.append(verb)
        return payload

    station.see(Received(f"{ROOT}/state", state("ready").payload, 1, True))
    monkeypatch.setattr(station, "ask", ask)
    requests = page_requests(station, SECRET, ManualClock())
    answers = [requests.do(verb, b'{"transaction":"1"}') for verb in ("select_part", "prove_gel")]

    assert signed == ["select_part"]
    assert json.loads(answers[1])["error"] == "this page has no request 'prove_gel'; ask the station itself"


def test_the_verb_serves_the_page_until_it_is_interrupted(mosquitto: LocalBroker) -> None:
    """It prints the address; without a secret the page only shows, and says so."""
    says(mosquitto, state("ready"))
    port = free_port()
    options = ["--port", str(mosquitto.port), "--host", mosquitto.host, "--page-port", str(port)]
    with subprocess.Popen([GELGATE, "page", *options], stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        line = next(line for line in running.stderr if "http" in line)
        wait_until(lambda: asked(port, "/state.json"))
        changes = asked(port, "/station.json")["changes"]
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 130

    assert f"the page is at http://127.0.0.1:{port}/" in line
    assert changes["why_not"] == "this page only shows: it was started without --secret-file and --token-file"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bind": "0.0.0.0"}, "bind = '0.0.0.0' needs allow_from"),
        ({"secret_file": "secret"}, "changes need --secret-file, which signs them for the station, and"),
        ({"token_file": "secret"}, "changes need --secret-file, which signs them for the station, and"),
        ({"secret_file": "nowhere", "token_file": "secret"}, "--secret-file: .*nowhere cannot be read"),
        ({"page_port": 80}, "'port' is 80"),
        ({"password_file": "nowhere"}, "password file .*nowhere cannot be read"),
        ({"password_file": "no text"}, "password file .*no text cannot be read"),
        ({"password_file": "empty"}, "password file .*empty is empty; write the password into it"),
    ],
)
def test_options_that_cannot_work_are_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(SECRET)
    secret.chmod(0o640)
    (tmp_path / "no text").write_bytes(b"\x7fELF\xff")
    (tmp_path / "empty").touch()
    given = {key: tmp_path / one if key.endswith("_file") else one for key, one in options.items()}

    with pytest.raises(ConfigError, match=words):
        page(**given)
