"""A region is drawn at the page, with a mouse and with a finger, over the picture of the last press."""

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import TOKEN
from ports import free_port
from station import Motion, press_recording, station_config

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.build import open_station
from edge.gateway.station_loop import StationLoop
from edge.model.bundle import Bundle

CORNERS_MM = ((4.4, 3.8), (8.6, 3.8), (8.6, 8.1), (4.4, 8.1))
"""Around the film's dent, and the cells of the map that it reaches."""


@pytest.fixture
def running(tmp_path: Path, bundle: Path) -> Iterator[tuple[StationLoop, int, Path]]:
    """A station whose presses are all dented, one every two seconds; gives the port of its page, and its bundle."""
    port, mine = free_port(), shutil.copytree(bundle, tmp_path / "bundles" / "pz0")
    token = tmp_path / "page.token"
    token.write_text(TOKEN)
    token.chmod(0o640)
    sinks = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port}, token_file = "{token}" }}\n'
    presses = press_recording(tmp_path / "presses", 2, dented=[0, 1], motion=Motion(free=28, idle=20), seed=5)
    config = station_config(
        tmp_path / "station",
        presses,
        mine,
        sinks=sinks,
        pace=1.0,
        loop=True,
        tables='[commands]\npage = ["set_regions"]',
    )
    stop = threading.Event()
    with open_station(load_config(config), SystemClock()) as gateway:
        thread = threading.Thread(target=gateway.run, args=(stop,))
        thread.start()
        yield gateway, port, mine
        stop.set()
        thread.join()


@pytest.mark.parametrize("by", ["mouse", "finger"])
def test_a_region_is_drawn_over_the_last_press(
    browser: Any, running: tuple[StationLoop, int, Path], by: str
) -> None:
    """Its corners are where they were set, to a tenth of a millimetre; the next press passes there, and the act is
    written down; a stricter one is answered with the command that can; a region is removed again."""
    gateway, port, mine = running
    tab = browser.new_page(viewport={"width": 1000, "height": 1100}, has_touch=by == "finger")
    tab.set_default_timeout(BROWSER_MS)
    wrong: list[str] = []
    tab.on("console", lambda message: wrong.append(message.text))
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.goto(f"http://127.0.0.1:{port}/")
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

    draw("stricter")
    tab.locator("#said", has_text="gelgate bundle regions").wait_for()
    draw("ignore")
    tab.locator("#said", has_text="ignored: 1").wait_for()
    tab.wait_for_selector("#verdict.pass")
    assert tab.inner_text("#ignored").startswith("Drawn: ignored: 1")
    (region,) = Bundle.load(mine).manifest.regions.regions  # type: ignore[union-attr]
    assert region.name == "the-logo"
    for drawn, wanted in zip(region.points_mm, CORNERS_MM, strict=True):
        assert drawn == pytest.approx(wanted, abs=0.1)

    tab.get_by_role("button", name="Remove the region the-logo").click()
    tab.locator("#said", has_text="no region is drawn any more").wait_for()
    tab.wait_for_selector("#verdict.fail")
    acts = [
        (act.who, act.verb, act.outcome) for act in gateway.parts.store.acts() if act.verb == "set_regions"
    ]
    assert acts == [("kim, at the page", "set_regions", outcome) for outcome in ("done", "done", "failed")]
    tab.close()
    assert wrong == []
