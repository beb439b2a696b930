"""A region is drawn at the page, with a mouse and with a finger, over the picture of the last press."""

import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import TOKEN
from ports import free_port
from real_brokers import require
from station import MQTT, Motion, press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.gateway.station_loop import StationLoop
from edge.messaging.local_broker import LocalBroker
from edge.messaging.mqtt_broker import Broker
from edge.model.bundle import Bundle
from edge.page.from_broker import BrokerStation, page_requests
from edge.page.server import PageServer
from edge.page.settings import PageSettings

SECRET = "0123456789abcdef"
CORNERS_MM = ((4.4, 3.8), (8.6, 3.8), (8.6, 8.1), (4.4, 8.1))
"""Around the film's dent, and the cells of the map that it reaches."""


@pytest.fixture(scope="module")
def running(
    tmp_path_factory: pytest.TempPathFactory, bundle: Path
) -> Iterator[tuple[StationLoop, dict[str, int], Path]]:
    """A station whose presses are all dented, one every two seconds; gives the ports of its page and of that from its
    broker, and its bundle."""
    require("mosquitto")
    tmp_path = tmp_path_factory.mktemp("drawn")
    port, mine = free_port(), shutil.copytree(bundle, tmp_path / "bundles" / "pz0")
    token, secret = tmp_path / "page.token", tmp_path / "line.secret"
    for file, content in ((token, TOKEN), (secret, SECRET)):
        file.write_text(content)
        file.chmod(0o640)
    presses = press_recording(tmp_path / "presses", 2, dented=[0, 1], motion=Motion(free=28, idle=20), seed=5)
    stop = threading.Event()
    with LocalBroker("mosquitto") as broker, ExitStack() as opened:
        sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port}, token_file = "{token}" }}\n'
        verbs = f'[commands]\npage = ["set_regions"]\nsigned = ["set_regions"]\nsecret_file = "{secret}"'
        given = {"sinks": sinks + MQTT % broker.port, "pace": 1.0, "loop": True, "tables": verbs}
        config = station_config(tmp_path / "station", presses, mine, **given)  # type: ignore[arg-type]
        afar = BrokerStation(Broker(broker.host, broker.port, "page"), "gelgate/+/+/+/gel/v1/#")
        opened.callback(afar.close)
        afar.start()
        changes = page_requests(afar, SECRET.encode(), SystemClock())
        page = PageServer(afar.shown, PageSettings(token_file=token), changes, SystemClock(), port=0)
        opened.callback(page.close)
        with open_station(load_config(config), SystemClock()) as gateway:
            thread = threading.Thread(target=gateway.run, args=(stop,))
            thread.start()
            yield gateway, {"station": port, "broker": page.port}, mine
            stop.set()
            thread.join()


@pytest.mark.parametrize(("by", "page"), [("mouse", "station"), ("finger", "broker")])
def test_a_region_is_drawn_over_the_last_press(
    browser: Any, running: tuple[StationLoop, dict[str, int], Path], by: str, page: str
) -> None:
    """Its corners are where they were set, to a tenth of a millimetre; the next press passes there, and the act is
    written down. With a mouse: a stricter one is answered with the command that can, and what is drawn stays; a region
    is removed."""
    gateway, ports, mine = running
    tab = browser.new_page(viewport={"width": 1000, "height": 900}, has_touch=by == "finger")
    tab.set_default_timeout(BROWSER_MS)
    wrong: list[str] = []
    tab.on("console", lambda message: wrong.append(message.text))
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.goto(f"http://127.0.0.1:{ports[page]}/")
    tab.wait_for_selector("#verdict.fail")
    assert not tab.locator("#draw-region").is_visible()
    tab.fill("#by", "kim")
    tab.fill("#token", TOKEN)
    tab.press("#token", "Enter")

    def draw(kind: str) -> None:
        tab.wait_for_selector("#draw-region", state="visible")
        tab.click("#draw-region")
        tab.wait_for_selector("#sheet image")
        assert tab.locator("#draw-sure").is_disabled()
        box = tab.evaluate(
            """() => { const sheet = document.getElementById("sheet");
            const view = sheet.viewBox.baseVal, to = sheet.getScreenCTM();
            const at = (x, y) => { const p = new DOMPoint(x, y).matrixTransform(to); return [p.x, p.y]; };
            return [at(view.x, view.y), at(view.x + view.width, view.y + view.height)]; }"""
        )
        (left, top), (right, bottom) = box
        beside = f"document.elementFromPoint({right + 10}, {(top + bottom) / 2}).tagName"
        assert tab.evaluate(beside) == "svg"  # nothing of the scores beside the press
        for x, y in CORNERS_MM:
            place = left + (right - left) * x / 14.204, top + (bottom - top) * y / 14.204
            if by == "mouse":
                tab.mouse.click(*place)
            else:
                tab.touchscreen.tap(*place)
        wait_until(tab, "document.getElementById('corners').textContent.startsWith('4 corners')")
        tab.select_option("#region-kind", kind)
        tab.fill("#region-name", "the logo")
        tab.click("#draw-sure")

    if by == "mouse":
        draw("stricter")
        tab.locator("#corners", has_text="gelgate bundle regions").wait_for()
        tab.select_option("#region-kind", "ignore")
        tab.click("#draw-sure")
    else:
        draw("ignore")
    tab.locator("#said", has_text="ignored: 1").wait_for()
    tab.wait_for_selector("#verdict.pass")
    assert tab.inner_text("#ignored").startswith("Drawn: ignored: 1")
    (region,) = Bundle.load(mine).manifest.regions.regions  # type: ignore[union-attr]
    assert region.name == "the-logo"
    for drawn, wanted in zip(region.points_mm, CORNERS_MM, strict=True):
        assert drawn == pytest.approx(wanted, abs=0.1)

    if by == "mouse":
        tab.get_by_role("button", name="Remove the region the-logo").click()
        tab.locator("#said", has_text="no region is drawn any more").wait_for()
        tab.wait_for_selector("#verdict.fail")
    acts = [
        (act.who, act.verb, act.outcome) for act in gateway.parts.store.acts() if act.verb == "set_regions"
    ]
    who = {"station": "kim, at the page", "broker": "kim, at a page, over MQTT, signed"}[page]
    outcomes = ("done", "done", "failed") if by == "mouse" else ("done",)
    assert acts[: len(outcomes)] == [(who, "set_regions", outcome) for outcome in outcomes]
    tab.close()
    assert wrong == []
