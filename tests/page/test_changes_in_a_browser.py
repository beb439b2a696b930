"""What a person changes on the page, in headless Chromium, at a running station whose broker is away."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import TOKEN, press, state
from ports import free_port
from station import MQTT, Motion, press_recording, station_config, two_parts

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.ports import Message
from edge.gateway.gateway import Gateway
from edge.messaging.local_broker import LocalBroker, available_brokers
from edge.messaging.mqtt_broker import Broker, Outgoing
from edge.messaging.mqtt_connection import Connection
from edge.page.access import Access, TokenGate
from edge.page.changes import Changes
from edge.page.from_broker import BrokerStation
from edge.page.server import PageServer

# What Chromium itself writes about an answer of status 401.
OF_THE_BROWSER = "Failed to load resource: the server responded with a status of 401 (Unauthorized)"


@pytest.fixture
def running(tmp_path: Path, bundle: Path) -> Iterator[tuple[Gateway, int]]:
    """Two parts, a press every second, a broker that is not there; gives the port of its page."""
    port, bundles = free_port(), two_parts(tmp_path / "bundles", bundle)
    token = tmp_path / "page.token"
    token.write_text(TOKEN)
    token.chmod(0o640)
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port}, token_file = "{token}" }}\n{MQTT % free_port()}'
    recording = press_recording(tmp_path / "presses", 3, motion=Motion(free=28, idle=6), seed=2)
    config = station_config(tmp_path / "station", recording, bundles, sinks=sinks, pace=1.0, loop=True)
    stop = threading.Event()
    with Gateway.open(load_config(config), SystemClock()) as gateway:
        thread = threading.Thread(target=gateway.run, args=(stop,))
        thread.start()
        yield gateway, port
        stop.set()
        thread.join()


@pytest.fixture
def tab(browser: Any, running: tuple[Gateway, int]) -> Iterator[Any]:
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


def said(tab: Any, words: str) -> None:
    """Wait until the page says this."""
    tab.locator("#said", has_text=words).wait_for()


def test_a_shift_at_the_page(tab: Any, running: tuple[Gateway, int]) -> None:
    """A wrong token, the right one by keyboard, another part, an alarm, a new gel: each is done and written down."""
    gateway, _ = running
    store = gateway.loop.parts.store
    tab.wait_for_selector("#verdict.pass, #verdict.fail")
    assert not tab.locator("#new-gel").is_visible()

    tab.fill("#token", "guess-guess")
    tab.press("#token", "Enter")
    said(tab, "Not unlocked: this is not the token of this page")
    assert not tab.locator("#new-gel").is_visible()

    tab.fill("#by", "kim")
    tab.fill("#token", TOKEN)
    tab.press("#token", "Enter")
    said(tab, "Unlocked.")
    assert tab.input_value("#token") == ""

    tab.wait_for_selector("#select", state="visible")
    tab.select_option("#parts", "PZ1/pos1")
    tab.click("#select button")
    wait_until(tab, "document.getElementById('selected').textContent === 'PZ1/pos1'")

    def raise_alarm(loop: Any) -> None:
        store.findings.append("database gelgate.db: it knew fewer presses")
        loop.publish_stats()

    gateway.loop.parts.calls.post(raise_alarm)
    tab.get_by_role("button", name="Acknowledge the alarm counts").click()
    said(tab, "The alarm counts is acknowledged.")
    wait_until(tab, "!document.getElementById('alarms').textContent.includes('fewer presses')")
    wait_until(tab, "document.getElementById('receivers').textContent.includes('127.0.0.1')")

    tab.click("#new-gel")
    assert tab.evaluate("document.activeElement.id") == "cancel"
    tab.press("#cancel", "Enter")
    assert not tab.locator("#confirm").is_visible()
    tab.click("#new-gel")
    tab.fill("#limit", "700")
    tab.fill("#note", "batch 7")
    tab.click("#sure")
    said(tab, "counts from now on. Leave it free until the station is ready.")
    wait_until(tab, "document.getElementById('gel').textContent.includes('of 700 presses')")

    tab.click("#lock")
    assert not tab.locator("#new-gel").is_visible()
    acts = [act for act in store.acts() if "page" in act.who]
    assert [(act.who, act.verb, act.outcome) for act in acts] == [
        ("kim, at the page", "replace_gel", "done"),
        ("kim, at the page", "acknowledge_alarm", "done"),
        ("kim, at the page", "select_part", "done"),
        ("page", "unlock", "refused"),
    ]
    assert acts[0].arguments == {"limit_presses": 700, "note": "batch 7"}


def test_a_broker_that_is_away_is_seen_and_the_page_goes_on(browser: Any) -> None:
    """What was shown stays, in grey; then it is as before."""
    if "mosquitto" not in available_brokers():
        pytest.skip("SKIPPED, NOT TESTED: the broker mosquitto is not installed")
    clock, root = SystemClock(), "gelgate/plant/line1/press2/gel/v1"
    with LocalBroker("mosquitto") as broker:
        station = BrokerStation(Broker(broker.host, broker.port, "page"), f"{root}/#")
        changes = Changes(None, TokenGate(None, clock), clock, "this page only shows")
        server = PageServer(station.shown, changes, Access(), "127.0.0.1", 0, clock)
        station.start()

        def says(*messages: Message) -> None:
            connection = Connection.open(Broker(broker.host, broker.port, "says", level="5", timeout_s=60.0))
            for one in messages:
                connection.publish(Outgoing(f"{root}/{one.topic}", one.payload, 1, one.retain))
            connection.close()

        one = browser.new_page()
        one.set_default_timeout(BROWSER_MS)
        one.goto(f"http://127.0.0.1:{server.port}/")
        wait_until(one, "document.getElementById('away').textContent.includes('has no message')")
        says(state("ready"), *press(1))
        one.wait_for_selector("#verdict.pass")
        assert one.inner_text("#why-not") == "this page only shows"
        assert not one.locator("#unlock").is_visible()

        broker.stop()
        wait_until(one, "document.getElementById('away').textContent.includes('trying again')")
        assert one.inner_text("#state") == "last known: ready"
        assert one.evaluate("getComputedStyle(document.querySelector('main')).opacity") == "0.35"

        broker.start()
        wait_until(one, "document.getElementById('away').textContent.includes('has no message')")
        says(state("ready"), *press(2))
        one.wait_for_selector("#away", state="hidden")
        wait_until(one, "document.querySelectorAll('#presses tr').length === 2")
        one.close()
        server.close()
        station.close()
