"""The manual as a site: built from the same pages, without a network, and opened in headless Chromium."""

import html
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import open_tab, wait_until
from command_line import gelgate
from page_messages import ROOT, ask

from edge.clock import SystemClock
from edge.core.sink_context import Station
from edge.extras import is_installed
from edge.page.manual import find_file
from plugins.sinks.page import PageOptions, PageSink


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every page, as `gelgate station docs --site` writes it."""
    if not is_installed("zensical"):
        pytest.skip("SKIPPED, NOT TESTED: the package zensical is not installed; pip install 'gelgate[docs]'")
    folder = tmp_path_factory.mktemp("manual") / "site"
    done = gelgate("station", "docs", "--site", folder)
    assert done.code == 0, done.err
    return folder


@pytest.fixture
def page(site: Path) -> Iterator[PageSink]:
    """The page of a station that names the folder."""
    opened = PageSink(PageOptions(manual=site), Station(ROOT, "press2"), SystemClock(), port=0)
    yield opened
    opened.close()


def test_a_port_in_use_is_refused_before_the_site_is_written(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = gelgate("station", "docs", "--site", tmp_path / "site", "--serve", "--port", port)
    assert "cannot be served at port" in refused.sentence()
    assert not (tmp_path / "site").exists()


def test_every_page_is_there_and_every_link_leads_to_a_page_and_its_heading(site: Path) -> None:
    """Pages, pictures and headings; what is elsewhere begins with https."""
    source = Path(__file__).resolve().parents[2] / "docs"
    names = [path.relative_to(source).with_suffix(".html") for path in source.rglob("*.md")]
    assert [name for name in names if not (site / "docs" / name).is_file()] == []

    pages = {
        path.relative_to(site).as_posix(): path.read_text(encoding="utf-8") for path in site.rglob("*.html")
    }
    headings = {name: set(re.findall(r'\bid="?([^"\s>]+)', text)) for name, text in pages.items()}
    lost = []
    for name, text in pages.items():
        for link in map(html.unescape, re.findall(r'(?:href|src)="?([^"\s>]+)', text)):
            path, _, heading = link.partition("#")
            if re.match(r"https?:|mailto:|data:|#__", link):
                continue
            target = os.path.normpath(os.path.join(os.path.dirname(name), path)) if path else name
            if not (site / target).exists() or (heading and heading not in headings.get(target, {heading})):
                lost.append((name, link))
    assert len(pages) > len(names)
    assert lost == []


def test_it_is_read_and_searched_in_a_browser_without_a_network(browser: Any, page: PageSink) -> None:
    """From the link on the station's page to a page that the search finds; nothing is asked of another machine, and no
    script is refused."""
    tab = open_tab(browser, page.port, viewport={"width": 1280, "height": 800})
    said: list[str] = []
    tab.wait_for_selector("#manual", state="visible")
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on(
        "request", lambda request: said.append(request.url) if f":{page.port}/" not in request.url else None
    )
    tab.goto(f"http://127.0.0.1:{page.port}/{tab.get_attribute('#manual', 'href')}")
    assert tab.inner_text("h1").startswith("gelgate")

    tab.keyboard.press("/")
    tab.keyboard.type("outbox_mb")
    is_found = "[...document.querySelectorAll('div')].some((one) => one.shadowRoot?.textContent.includes('outbox_mb'))"
    wait_until(tab, is_found)
    tab.keyboard.press("Enter")
    tab.wait_for_url(re.compile(r"/manual/docs/"))
    assert "outbox_mb" in tab.inner_text("article")
    tab.close()
    assert [line for line in said if not line.startswith(("data:", "Autofocus processing was blocked"))] == []


@pytest.mark.parametrize(
    "path",
    [
        "",
        "nothing.html",
        "../secret",
        "%2e%2e/secret",
        "docs/../../secret",
        "docs",
        "link",
        "%00",
        "a" * 5000,
    ],
    ids=lambda path: path[:20],
)
def test_no_other_file_is_given(path: str, tmp_path: Path) -> None:
    """Not beside the folder, nor where a link in it leads; a folder is no page."""
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "site" / "docs").mkdir(parents=True)
    (tmp_path / "site" / "link").symlink_to(tmp_path / "secret")
    assert find_file(tmp_path / "site", path) is None


def test_a_page_without_a_manual_says_so(tmp_path: Path) -> None:
    """A folder that is not there is a warning and no link, and stops no station."""
    options = PageOptions(manual=tmp_path / "absent")
    assert "`gelgate station docs --site` makes it" in options.warnings()[0]
    opened = PageSink(options, Station(ROOT, "press2"), SystemClock(), port=0)
    status, content = ask(opened.port, "/station.json")
    opened.close()
    assert (status, b'"has_manual": false' in content) == (200, True)


def test_a_folder_of_something_else_is_not_overwritten(tmp_path: Path) -> None:
    """The site takes the place of an older site alone."""
    (tmp_path / "mine.txt").write_text("mine")
    if is_installed("zensical"):
        refused = gelgate("station", "docs", "--site", tmp_path)
        assert (refused.code, "holds no manual; choose a new folder" in refused.sentence()) == (3, True)
    assert (tmp_path / "mine.txt").read_text() == "mine"
