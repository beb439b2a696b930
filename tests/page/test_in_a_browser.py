"""The page in headless Chromium: it shows what the station says, and a person with the token changes something."""

import re
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS, open_tab, wait_until
from page_messages import PICTURE, ROOT, T0_NS, TOKEN, contact, drift, gel, info, piece, press, state, stats
from ports import free_port
from station import MQTT, Motion, press_recording, station_config, two_parts
from stepped_station import correct_counts

from edge.clock import ManualClock, SystemClock
from edge.config import load_config
from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.core.sink_context import Station
from edge.core.verdict import Cause, Kind
from edge.gateway.build import open_station
from edge.gateway.station_loop import StationLoop
from edge.messaging.alarm_payload import ALARMS, AlarmPayload
from edge.messaging.result_payload import PressAgainPart
from plugins.sinks.page import PageOptions, PageSink


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
        AlarmPayload(time_ns=T0_NS, alarm="gel", text="gel S-1 is due", severity="warning").message(),
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
    assert tab.inner_text(
        "#alarms .alarm"
    ) == f"gel S-1 is due\nWhat to do: {ALARMS['gel'].what_to_do}".replace("`", "")
    assert tab.inner_text("#selected") == "bolt/pos1"
    assert tab.inner_text("#unproven") == "not proven: the bundle finds 1 of 48"
    assert "GelSight Mini R0B, serial 2BNN4ZE7, 24.9 frames a second" in tab.inner_text("#sensor")
    assert "801 of 1000 presses, 199 left: due" in tab.inner_text("#gel")
    assert (tab.inner_text("#state"), tab.get_attribute("#state", "class")) == ("ready, 1 alarm", "alarmed")
    assert "mqtt: no broker answers" in tab.inner_text("#receivers")
    assert tab.locator("#presses tr").count() == 2
    wait_until(tab, "document.getElementById('picture').naturalWidth > 0")


def test_a_press_of_before_the_start_is_listed_and_is_not_the_verdict(browser: Any) -> None:
    """With its day, where that is another one; the part that lies there now was not judged."""
    before = {"press_id": "0" * 26, "sequence": 1, "part": "bolt", "verdict": "pass", "score_ratio": 0.7}
    before |= {"time_ns": T0_NS, "time_ms": T0_NS // 10**6}
    station = Station(ROOT, "press2", earlier=lambda most: [before])
    with closing(PageSink(PageOptions(), station, ManualClock(), port=0)) as sink:
        tab = browser.new_page()
        tab.goto(f"http://127.0.0.1:{sink.port}/")
        tab.wait_for_selector("#presses tr")
        assert tab.inner_text("#verdict").lower() == "no press yet"
        assert re.search(r"PASS\s+0.70\s+bolt\s+\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", tab.inner_text("#presses"))

        for message in (state("ready"), *press(2)):
            sink.send(message)
        tab.wait_for_selector("#verdict.pass")
        assert tab.locator("#presses tr").count() == 2
        tab.close()


def test_charts_of_passing_presses_say_what_has_shifted_and_what_to_do(tab: Any, sink: PageSink) -> None:
    """Each chart has a line on either side between its limits. A shift is said in words, with what to do, as text; few
    presses are still learnt. Light that is followed is said with the newest press."""
    assert not tab.locator("#drift").is_visible()

    sink.send(drift(shift=-1, what_to_do="check <b>the lamp</b>"))
    for message in press(1, light_gain=(1.2, 1.0, 1.04)):
        sink.send(message)

    tab.wait_for_selector("#charts li.shifted")
    assert "bolt/pos1 on gel S-1" in tab.inner_text("#drift-of")
    assert tab.locator("#charts li").all_inner_texts() == [
        "score / threshold: 0.761 lately, 0.75 in the mean: no shift",
        "light of the free gel: 98 levels lately, 117 levels in the mean: lower than before; check <b>the lamp</b>",
    ]
    assert tab.locator("#charts polyline").count() == 4
    lowest = "Number(document.querySelector('#charts polyline.out').getAttribute('points').split(',').pop())"
    limit = "Number(document.querySelectorAll('#charts li.shifted line.limit')[1].getAttribute('y1'))"
    assert tab.evaluate(f"{lowest} > {limit}")
    assert "1.20, 1.00, 1.04 times brighter" in tab.inner_text("#followed")

    sink.send(drift(count=7))
    wait_until(tab, "document.getElementById('charts').textContent.includes('7 of 20 presses learnt')")
    for message in press(2):
        sink.send(message)
    wait_until(tab, "document.getElementById('followed').textContent === ''")


AGAIN = PressAgainPart(is_asked=True, reason="press the same piece again, a little shifted")


@pytest.mark.parametrize(
    ("outcome", "word", "why"),
    [
        ({"verdict": None, "score": None, "score_ratio": None, "error": "saturated"}, "error", "saturated"),
        ({"verdict": Kind.UNSURE, "press_again": AGAIN}, "unsure", AGAIN.reason),
        # It says whether to wipe the gel or to put the part aside.
        ({"verdict": Kind.FAIL, "cause": Cause.GEL, "cause_text": "a mark there"}, "fail", "cause: gel"),
        ({"verdict": Kind.UNSURE, "is_at_rest": False}, "unsure", "lifted before it rested"),
        (
            {"verdict": Kind.UNSURE, "blind_area_mm2": 0.9},
            "unsure",
            "0.90 mm2 under a mark of the gel are not judged: wipe it",
        ),
    ],
)
def test_the_reason_of_a_verdict_is_shown(
    tab: Any, sink: PageSink, outcome: dict[str, Any], word: str, why: str
) -> None:
    """A press without a score is never a pass, and the picture of the press before is taken away."""
    for message in press(1, picture=PICTURE):
        sink.send(message)
    tab.wait_for_selector("#picture", state="visible")
    for message in press(2, picture=None, **outcome):
        sink.send(message)

    tab.wait_for_selector(f"#verdict.{word}")
    assert tab.inner_text("#why") == why
    assert tab.inner_text("#cause") == outcome.get("cause_text", "")
    assert tab.locator("#picture").is_hidden()


def test_a_piece_is_no_pass_before_all_of_it_has_passed(tab: Any, sink: PageSink) -> None:
    """Instead of the pass of a place it says how far it is, and what is to be pressed; a fail is large at once."""
    for message in (state("ready"), piece((None, None, None), piece_id=None)):
        sink.send(message)
    tab.wait_for_selector("#pieces", state="visible")
    assert tab.inner_text("#todo") == "Press: bolt/left or bolt/middle or bolt/right"

    def becomes(said: str, name: str, *messages: Message) -> None:
        for message in messages:
            sink.send(message)
        verdict = "document.getElementById('verdict')"
        wait_until(tab, f"{verdict}.textContent === '{said}' && {verdict}.classList.contains('{name}')")

    one: dict[str, Any] = {"piece_id": "0042", "place": "bolt/left"}
    failed = press(2, verdict=Kind.FAIL, score=2.5, score_ratio=2.5, **one)
    ended = piece((None, None, None), piece_id=None, last=("0042", "pass"))
    becomes("1 of 3", "none", *press(1, **one), piece(("pass", None, None)))
    assert tab.locator("#places li").all_inner_texts() == [
        "bolt/left: pass",
        "bolt/middle: to be pressed",
        "bolt/right: to be pressed",
    ]
    becomes("fail", "fail", *failed, piece(("pass", "fail", None)))
    becomes("0 of 3", "none", piece((None, None, None), piece_id="0043"))
    becomes("fail", "fail", *press(3, **one), piece(("pass", "fail", None)))
    becomes("pass", "pass", *press(4, **one), ended)
    assert "0042: pass" in tab.inner_text("#piece")
    becomes("0 of 3", "none", piece((None, None, None), piece_id="0043"))


def test_a_pass_of_one_place_is_none_where_the_piece_is_not_known(tab: Any, sink: PageSink) -> None:
    """As where a broker's rules lack its topic, or while it is on its way: the others may be missing."""
    for message in (state("ready"), *press(1, piece_id="0042", place="bolt/left")):
        sink.send(message)

    tab.wait_for_selector("#presses tr")
    assert tab.inner_text("#verdict").lower() == "bolt/left"
    assert tab.get_attribute("#verdict", "class") == "none"


def test_a_hand_is_told_what_to_do_and_never_what_is_over(tab: Any, sink: PageSink) -> None:
    """The word and the way while it is said; a second later, and at a station that is not ready, nothing."""

    def told(message: Message, sentence: str) -> None:
        sink.send(message)
        wait_until(
            tab,
            f"document.getElementById('advice').innerText === '{sentence}' && !document.getElementById('hand').hidden",
        )

    sink.send(state("ready"))
    told(contact("pressing", "deeper"), "Press deeper")
    assert not tab.locator("#arrow").is_visible()
    told(contact("pressing", "shift", 90.0, ms=200), "Shift the part")
    assert "rotate(90deg)" in str(tab.get_attribute("#arrow", "style"))
    told(contact("deep_enough", "tilt", 180.0, ms=400), "Press this side more")
    told(contact("at_rest", "hold", ms=600), "Hold still")
    told(contact("lift", "lift", ms=800), "Lift")
    told(contact("overload", "lift", ms=1000), "Too deep: take it off")
    sink.send(contact("free", ms=1200))
    wait_until(tab, "document.getElementById('hand').hidden")
    told(contact("lift", "lift", ms=1400), "Lift")
    wait_until(tab, "document.getElementById('hand').hidden")  # nothing came for a second
    told(contact("lift", "lift", ms=3000), "Lift")
    sink.send(state("halted", "a test"))
    wait_until(tab, "document.getElementById('hand').hidden")


def test_no_press_is_asked_about_with_the_picture_of_another(tab: Any, sink: PageSink) -> None:
    """While a slow network brings its own, none is shown."""
    for number in (1, 2, 3):
        for message in press(number, picture=PICTURE):
            sink.send(message)
    wait_until(tab, "document.querySelectorAll('#presses a').length === 3")
    tab.evaluate("askWhat(shown.presses[2], true)")
    tab.wait_for_selector("#what-picture", state="visible")
    tab.click("#what-cancel")
    held: list[Any] = []
    tab.route("**/pictures/*", lambda route: held.append(route))

    with tab.expect_request("**/pictures/*"):
        tab.evaluate("askWhat(shown.presses[1], true)")
    is_shown_early = tab.locator("#what-picture").is_visible()
    for route in held:
        route.continue_()
    tab.unroute("**/pictures/*")

    tab.wait_for_selector("#what-picture", state="visible")
    assert not is_shown_early


def test_a_fail_never_reads_as_its_threshold(tab: Any, sink: PageSink) -> None:
    """In the list, and in the line below the verdict."""
    ratios = {1.19: "1.19", 1.0: "1.00", 1.0021: "1.002", 0.99999: "0.99999"}
    for number, ratio in enumerate(ratios, 1):
        for message in press(number, verdict=Kind.FAIL, score=ratio, score_ratio=ratio):
            sink.send(message)

    wait_until(tab, "document.querySelectorAll('#presses tr').length === 4")
    assert tab.locator("#presses td:nth-child(2)").all_inner_texts() == list(ratios.values())[::-1]
    assert "0.99999 × threshold" in tab.inner_text("#facts")


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
    unnamed = (
        "[...document.querySelectorAll('input, select')]"
        ".filter((one) => !one.labels.length && !one.ariaLabel).length"
    )
    assert tab.evaluate(unnamed) == 0


def test_a_pass_is_shown_only_while_the_station_inspects(tab: Any, sink: PageSink) -> None:
    """As the lights do, which have forgotten all of it when the station inspects again; a fail stays."""
    for message in (state("ready"), *press(1, picture=PICTURE)):
        sink.send(message)
    tab.wait_for_selector("#verdict.pass")
    tab.wait_for_selector("#picture", state="visible")
    for now, verdict in (("halted", "halted"), ("ready", "no press yet"), ("starting", "no press yet")):
        sink.send(state(now))
        wait_until(tab, f"document.getElementById('verdict').textContent === '{verdict}'")
        assert tab.locator("#verdict.pass").count() == 0
    assert tab.inner_text("#facts") + tab.inner_text("#why") == ""
    assert tab.locator("#picture").is_hidden()
    for message in press(2, verdict=Kind.FAIL, score=2.5, score_ratio=2.5):
        sink.send(message)
    tab.wait_for_selector("#verdict.fail")


def test_a_gateway_that_is_gone_is_seen(browser: Any, sink: PageSink) -> None:
    """The page says so, and it is grey. A pass from before is not there any more: grey, it could be read from afar."""
    one = open_tab(browser, sink.port)
    for message in (state("ready"), *press(1)):
        sink.send(message)
    one.wait_for_selector("#verdict.pass")

    sink.close()

    one.wait_for_selector("#state.lost")
    assert one.inner_text("#state") == "the gateway does not answer"
    assert one.text_content("#verdict") == "lost"
    assert one.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "0.35"
    one.close()


def test_a_gateway_that_is_silent_is_seen(tab: Any, sink: PageSink) -> None:
    """As one whose cable is pulled: no request ends, and nothing is refused. Later it answers again."""
    for message in (state("ready"), *press(1)):
        sink.send(message)
    tab.wait_for_selector("#verdict.pass")
    tab.route("**/live.json*", lambda route: None)
    tab.clock.install()
    with tab.expect_request("**/live.json*"):
        sink.send(stats(mqtt="up"))
    tab.clock.fast_forward(9_000)

    tab.wait_for_selector("body.gone #state.lost")
    assert tab.text_content("#verdict") == "lost"

    tab.unroute("**/live.json*")
    tab.clock.fast_forward(2_000)
    tab.wait_for_selector("body:not(.gone) #verdict.pass")


# What Chromium itself writes about an answer of status 401.
OF_THE_BROWSER = "Failed to load resource: the server responded with a status of 401 (Unauthorized)"


@pytest.fixture
def running(tmp_path: Path, bundle: Path) -> Iterator[tuple[StationLoop, int]]:
    """Two parts, a press every second, a broker that is not there; gives the port of its page."""
    port, bundles = free_port(), two_parts(tmp_path / "bundles", bundle)
    token = tmp_path / "page.token"
    token.write_text(TOKEN)
    token.chmod(0o640)
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port}, token_file = "{token}" }}\n{MQTT % free_port()}'
    recording = press_recording(tmp_path / "presses", 3, motion=Motion(free=28, idle=6), seed=2)
    config = station_config(tmp_path / "station", recording, bundles, sinks=sinks, pace=1.0, loop=True)
    stop = threading.Event()
    with open_station(load_config(config), SystemClock()) as gateway:
        thread = threading.Thread(target=gateway.run, args=(stop,))
        thread.start()
        yield gateway, port
        stop.set()
        thread.join()


@pytest.fixture
def changing(browser: Any, running: tuple[StationLoop, int]) -> Iterator[Any]:
    """The page, opened; at the end there was no other message on the console than of the refused token."""
    one = browser.new_page(viewport={"width": 1280, "height": 900})
    one.set_default_timeout(BROWSER_MS)
    said: list[str] = []
    one.on("console", lambda message: said.append(message.text))
    one.on("pageerror", lambda error: said.append(str(error)))
    one.goto(f"http://127.0.0.1:{running[1]}/")
    yield one
    one.close()
    assert [line for line in said if line != OF_THE_BROWSER] == []


def said(changing: Any, words: str) -> None:
    """Wait until the page says this."""
    changing.locator("#said", has_text=words).wait_for()


def test_a_shift_at_the_page(changing: Any, running: tuple[StationLoop, int]) -> None:
    """A wrong token, the right one by keyboard, another part, an alarm, a new gel: each is done and written down."""
    gateway, _ = running
    store = gateway.parts.store
    changing.wait_for_selector("#verdict.pass, #verdict.fail")
    assert not changing.locator("#new-gel").is_visible()

    changing.fill("#token", "guess-guess")
    changing.press("#token", "Enter")
    said(changing, "Not unlocked: this is not the token of this page")
    assert not changing.locator("#new-gel").is_visible()

    changing.fill("#by", "kim")
    changing.fill("#token", TOKEN)
    changing.press("#token", "Enter")
    said(changing, "Unlocked.")
    assert changing.input_value("#token") == ""

    changing.wait_for_selector("#ask button")
    changing.click("#ask button")
    changing.fill("#kind", "burr")
    changing.press("#kind", "Enter")  # says nothing: the first button is "good"
    changing.click("#what button[value=damaged]")
    said(changing, "Kept: damaged, burr. The station had said")

    changing.wait_for_selector("#select", state="visible")
    changing.select_option("#parts", "PZ1/pos1")
    changing.click("#select button")
    wait_until(changing, "document.getElementById('selected').textContent === 'PZ1/pos1'")

    def raise_alarm(loop: Any) -> None:
        correct_counts(store, "database gelgate.db: it knew fewer presses")
        loop.publish_stats()

    gateway.parts.calls.post(raise_alarm)
    changing.get_by_role("button", name="Acknowledge the alarm counts").click()
    said(changing, "The alarm counts is acknowledged.")
    wait_until(changing, "!document.getElementById('alarms').textContent.includes('fewer presses')")
    wait_until(changing, "document.getElementById('receivers').textContent.includes('127.0.0.1')")

    changing.click("#new-gel")
    assert changing.evaluate("document.activeElement.id") == "cancel"
    changing.press("#cancel", "Enter")
    assert not changing.locator("#confirm").is_visible()
    changing.click("#new-gel")
    changing.fill("#limit", "700")
    changing.fill("#gel-serial", "G7")
    changing.fill("#use-by", "2001-01-31")
    changing.fill("#note", "batch 7")
    changing.click("#sure")
    said(
        changing,
        "is past its use-by date 2001-01-31: mount another one. Leave it free until the station is ready.",
    )
    wait_until(changing, "document.getElementById('gel').textContent.includes('of 700 presses')")
    assert "serial G7, use by 2001-01-31" in changing.inner_text("#gel")

    changing.click("#lock")
    assert not changing.locator("#new-gel").is_visible()
    acts = [act for act in store.acts() if "page" in act.who]
    assert [(act.who, act.verb, act.outcome) for act in acts] == [
        ("kim, at the page", "replace_gel", "done"),
        ("kim, at the page", "acknowledge_alarm", "done"),
        ("kim, at the page", "select_part", "done"),
        ("kim, at the page", "confirm_press", "done"),
        ("page", "unlock", "refused"),
    ]
    package = {"gel_serial": "G7", "use_by": "2001-01-31"}
    assert acts[0].arguments == {"limit_presses": 700, "note": "batch 7", **package}
