"""Changes from the page: the station's own command table, policy and acts; who is refused, and what is written down."""

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from page_messages import ROOT, TOKEN, ask, asked
from ports import free_port
from station import station_config, two_parts
from stepped_station import SteppedStation, correct_counts

from edge.clock import ManualClock
from edge.core.sink_context import PageRequests, Station
from edge.gateway.commands import Change, CommandPolicy, Commands
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES
from edge.page.changes import WRONG_PER_MINUTE
from edge.store.press_store import Store
from plugins.sinks.page import PageOptions, PageSink

RIGHT = f"Bearer {TOKEN}"


@dataclass
class Bench:
    """A page at a port, and what is behind it. turn: of the station's loop, while a request is made."""

    port: int
    store: Store
    turn: Callable[[], object]

    def post(self, verb: str, token: str | None = RIGHT, **more: Any) -> tuple[int, dict[str, Any]]:
        """Status and answer of a request. more: fields of the request, and headers that begin with a capital."""
        headers = {key: more.pop(key) for key in list(more) if key[0].isupper()}
        body = headers.pop("Body", None) or json.dumps({"transaction": "1", **more}).encode()
        with ThreadPoolExecutor() as pool:
            asking = pool.submit(
                ask, self.port, f"/requests/{verb}", "POST", body, Authorization=token, **headers
            )
            while not asking.done():
                self.turn()
            status, answer = asking.result()
        return status, json.loads(answer)

    def acts(self) -> list[tuple[str, str, str | None, str | None]]:
        """Newest first, but for what the station itself does."""
        found = self.store.acts()
        return [(act.who, act.verb, act.outcome, act.sentence) for act in found if act.who != "the gateway"]


def token_file(folder: Path) -> Path:
    path = folder / "page.token"
    path.write_text(TOKEN)
    path.chmod(0o640)
    return path


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[Bench]:
    """The station's table of requests without a station: one verb for the page, one over MQTT."""
    clock = ManualClock(1_780_000_000 * 10**9)
    policy = CommandPolicy(ROOT, frozenset({"trigger"}), page=frozenset({"replace_gel"}))
    with Store(tmp_path / "gelgate.db", monotonic_ns=clock.monotonic_ns) as store:
        done = Commands(
            dict.fromkeys(("replace_gel", "trigger"), lambda asked: Change({})), policy, store, clock
        )
        page = PageRequests(done.page_verbs, done.from_page, done.refuse_at_page)
        options = PageOptions(token_file=token_file(tmp_path))
        sink = PageSink(options, Station(ROOT, "press2", page=page), clock, port=0)
        yield Bench(sink.port, store, lambda: time.sleep(0.001))
        sink.close()


@pytest.fixture
def bench(tmp_path: Path, recording: Path, bundle: Path) -> Iterator[tuple[Bench, SteppedStation]]:
    port, bundles = free_port(), two_parts(tmp_path / "bundles", bundle)
    token = token_file(tmp_path)
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port}, token_file = "{token}" }}\n'
    config = station_config(tmp_path / "station", recording, bundles, sinks=sinks)
    with SteppedStation(config) as station:
        station.play(3)
        yield Bench(port, station.parts.store, station.turn), station


def test_what_a_person_changes_at_the_page(bench: tuple[Bench, SteppedStation]) -> None:
    """The verbs, each done at the station and written down with the person who gave a name. A browser that asks twice
    for the same gets the first outcome; what the station refuses is admitted, and its answer says how it ended."""
    page, station = bench
    verbs = ["acknowledge_alarm", "begin_piece", "confirm_press", "replace_gel", "select_part"]
    assert asked(page.port, "/station.json")["changes"] == {"verbs": verbs, "why_not": None}
    correct_counts(station.parts.store, "database gelgate.db: it knew fewer presses")
    station.loop.publish_stats()

    status, selected = page.post("select_part", by="kim", arguments={"name": "PZ1/pos1"})
    acknowledged = page.post("acknowledge_alarm", arguments={"alarm": "counts"})[1]
    gel = {"limit_presses": 700, "note": "batch 7"}
    first, second = (page.post("replace_gel", arguments=gel)[1] for _ in range(2))
    refused_status, refused = page.post("select_part", transaction="2", arguments={"name": "PZ9"})

    assert (status, selected["status"], selected["data"]["part"]) == (200, "ok", "PZ1")
    assert station.parts.selection.part.part == "PZ1"
    assert (acknowledged["status"], acknowledged["data"]) == ("ok", {"alarms": []})
    assert (first["data"]["presses"], first["data"]["limit_presses"]) == (0, 700)
    assert (second["status"], second["is_repeated"]) == ("ok", True)
    assert (refused_status, refused["status"]) == (200, "error")
    assert refused["error"].startswith("no part of this station is named 'PZ9'")
    assert [act[:3] for act in page.acts()] == [
        ("page", "select_part", "failed"),
        ("page", "replace_gel", "done"),
        ("page", "acknowledge_alarm", "done"),
        ("kim, at the page", "select_part", "done"),
    ]


@pytest.mark.parametrize(
    ("token", "words"),
    [
        (None, "a change needs the token of this page"),
        ("Bearer guess-guess", "this is not the token of this page"),
    ],
)
@pytest.mark.parametrize("verb", ["replace_gel", "unlock"])
def test_a_wrong_token_is_a_sentence_and_an_act(
    alone: Bench, verb: str, token: str | None, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    """And nothing is done. The token is in neither, nor in the log."""
    status, answer = alone.post(verb, token)

    assert (status, answer["status"], answer["error"]) == (401, "error", words)
    assert alone.acts() == [("page", verb, "refused", words)]
    assert words in caplog.text
    assert "guess" not in caplog.text + json.dumps(answer) + str(alone.store.acts())


def test_guesses_are_limited_and_unlocking_is_no_act(alone: Bench) -> None:
    """Nothing was changed by the right token; of the guesses the rest is refused without a row."""
    assert alone.post("unlock")[1]["status"] == "ok"
    assert alone.acts() == []
    statuses = [alone.post("unlock", "Bearer guess-guess")[0] for _ in range(WRONG_PER_MINUTE + 3)]

    assert statuses == [401] * WRONG_PER_MINUTE + [429] * 3
    assert len(alone.acts()) == WRONG_PER_MINUTE


def test_a_verb_that_is_not_for_the_page_is_refused(alone: Bench) -> None:
    """Also with the token, and also one that everybody may ask for over MQTT."""
    status, answer = alone.post("trigger")

    assert (status, answer["status"]) == (200, "error")
    assert "is off at the page of this station" in answer["error"]
    assert alone.acts()[0][2] == "refused"


@pytest.mark.parametrize(
    ("headers", "status", "words"),
    [
        ({"Origin": "http://attacker.example"}, 403, "comes from another page"),
        ({"Sec_Fetch_Site": "cross-site"}, 403, "comes from another page"),
        ({"Content_Type": None}, 415, "is sent as application/json"),
        ({"Content_Length": None}, 411, "says how many bytes"),
        ({"Body": b" " * (LARGEST_REQUEST_BYTES + 1)}, 413, "has at most 16384 bytes, this one has 16385"),
        ({"Content_Length": "9" * 30}, 413, "has at most 16384 bytes"),
    ],
)
def test_another_page_and_what_is_no_request_are_refused(
    alone: Bench, headers: dict[str, Any], status: int, words: str
) -> None:
    """Although the token is right: nothing is done, and each has a sentence."""
    found, answer = alone.post("replace_gel", **headers)

    assert (found, answer["status"]) == (status, "error")
    assert words in answer["error"]
    assert [act[2] for act in alone.acts()] == (["refused"] if status == 403 else [])


def test_requests_of_other_pages_do_not_fill_the_table(alone: Bench) -> None:
    """Each is refused; one a minute is written down, and a guess at the token after them too."""
    answers = [alone.post("replace_gel", token=None, Origin="http://attacker.example")[0] for _ in range(30)]
    alone.post("replace_gel", "Bearer guess")

    assert answers == [403] * 30
    assert [act[3] for act in alone.acts()] == [
        "this is not the token of this page",
        "this request comes from another page; only this one may ask for a change",
    ]


def test_a_name_server_of_others_does_not_help(alone: Bench) -> None:
    """Their name is in the request; it is refused before anything is read."""
    body = b'{"transaction":"1"}'
    status, answer = ask(
        alone.port, "/requests/replace_gel", "POST", body, Authorization=RIGHT, Host="attacker.example"
    )

    assert status == 403
    assert answer.startswith(b"this page is not known as 'attacker.example'; use its address (127.0.0.1)")


def test_a_request_that_is_no_json_is_refused_by_the_station(alone: Bench) -> None:
    """With the words that a request over MQTT gets."""
    answer = alone.post("replace_gel", Body=b"{")[1]

    assert answer["status"] == "error"
    assert "Invalid JSON" in answer["error"]


@pytest.mark.parametrize(
    "path", ["/requests/", "/requests/../x", "/requests/replace-gel", "/station.json", "/"]
)
def test_other_addresses_take_no_request(alone: Bench, path: str) -> None:
    assert ask(alone.port, path, "POST", b"{}", Authorization=RIGHT)[0] == 404


def test_without_a_token_the_page_only_shows(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """It says so, and an attempt is an act."""
    port = free_port()
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port} }}\n'
    config = station_config(tmp_path, recording, bundle, sinks=sinks)
    with SteppedStation(config) as station:
        bench = Bench(port, station.parts.store, lambda: station.loop.step(None))
        said = asked(port, "/station.json")["changes"]
        status, answer = bench.post("replace_gel")
        acts = bench.acts()

    assert said == {"verbs": [], "why_not": "this page only shows: no token is configured for it"}
    assert (status, answer["error"]) == (403, said["why_not"])
    assert acts == [("page", "replace_gel", "refused", said["why_not"])]
