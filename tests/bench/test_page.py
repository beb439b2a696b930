"""The time until the page is painted. Budget: 300 ms."""

import os
from statistics import median
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_pictures import SCENES, served

pytestmark = pytest.mark.bench

OPENINGS = 21

# When the verdict is on the screen: two frames after its text has come.
NOTE_VERDICT = """
new MutationObserver((changes, observer) => {
  if (document.querySelector("#verdict.fail")) {
    observer.disconnect();
    requestAnimationFrame(() => requestAnimationFrame(() => { window.verdictMs = performance.now(); }));
  }
}).observe(document, { subtree: true, childList: true, attributes: true });
"""
PAINTED = "performance.getEntriesByName('first-contentful-paint')[0]"


def test_time_until_it_is_painted(browser: Any) -> None:
    """In a new window each time, so nothing is in a cache; the page has presses, a picture and an alarm."""
    painted, seen, loaded = [], [], []
    with served(SCENES["page"]) as port:
        for _ in range(OPENINGS):
            context = browser.new_context(viewport={"width": 1280, "height": 900})
            tab = context.new_page()
            tab.set_default_timeout(BROWSER_MS)
            tab.add_init_script(NOTE_VERDICT)
            tab.goto(f"http://127.0.0.1:{port}/")
            wait_until(tab, f"window.verdictMs && {PAINTED}?.startTime")
            painted.append(tab.evaluate(f"{PAINTED}.startTime"))
            seen.append(tab.evaluate("window.verdictMs"))
            sizes = "performance.getEntries().reduce((sum, one) => sum + (one.decodedBodySize || 0), 0)"
            loaded.append(tab.evaluate(sizes))
            context.close()

    print(
        f"\n{OPENINGS} openings, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, median (least, most):"
    )
    print(f"painted after {spread(painted)} ms (budget 300), the verdict after {spread(seen)} ms")
    print(f"{median(loaded) / 1e3:.0f} kB with the picture of the press")


def spread(values: list[float]) -> str:
    return f"{median(values):.0f} ({min(values):.0f}, {max(values):.0f})"
