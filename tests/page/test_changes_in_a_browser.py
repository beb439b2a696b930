"""What a person changes on the page, in headless Chromium, at a running station whose broker is away."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import TOKEN
from ports import free_port
from station import MQTT, Motion, press_recording, station_config, two_parts

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.gateway import Gateway

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
