"""The system's Chromium, driven without a window; playwright brings none of its own."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import pytest

# On a busy machine a browser takes long to start.
BROWSER_MS: Final = 120_000

_PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def wait_until(tab: Any, expression: str) -> None:
    """Ask the page again and again until this is true there; a page with a strict policy does not wait by itself."""
    deadline = time.monotonic() + BROWSER_MS / 1000
    while not tab.evaluate(expression):
        assert time.monotonic() < deadline, f"it did not come to {expression}"
        tab.wait_for_timeout(10)


def open_tab(browser: Any, port: int, **options: Any) -> Any:
    """Open what is served at this port of this machine; options: of the browser's `new_page`."""
    tab = browser.new_page(**options)
    tab.set_default_timeout(BROWSER_MS)
    tab.goto(f"http://127.0.0.1:{port}/")
    return tab


@contextmanager
def chromium() -> Iterator[Any]:
    """A playwright browser; the test is skipped, and says so, where there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="SKIPPED, NOT TESTED: the package playwright is not installed"
    )
    if _PROGRAM is None:
        pytest.skip("SKIPPED, NOT TESTED: there is no Chromium; apt-get install chromium")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(
            executable_path=_PROGRAM, args=["--no-sandbox", "--disable-dev-shm-usage"], timeout=BROWSER_MS
        )
        yield opened
        opened.close()
