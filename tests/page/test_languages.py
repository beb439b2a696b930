"""The operator's page in other languages: every text is in every catalogue, and none is cut or left in English."""

import ast
import inspect
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args

import pytest
from chromium import BROWSER_MS, wait_until
from page_messages import press
from page_pictures import READY, SCENES, TOKEN, Scene, served

from edge.core.drawn_regions import RegionKind
from edge.core.drift import MEASURES
from edge.core.gel_life import GelState
from edge.core.gel_scars import causes
from edge.core.imaging.quality import Reason
from edge.core.verdict import Cause, Kind
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.status_payloads import StatePayload
from edge.page.server import LANGUAGES

FILES = Path(__file__).resolve().parents[2] / "edge" / "page" / "files"
SCRIPT = (FILES / "page.js").read_text(encoding="utf-8")
# The sentences of `edge/core/gel_scars/causes.py` without values, which are all.
BLAMES = {
    ast.literal_eval(call.args[1])
    for call in ast.walk(ast.parse(inspect.getsource(causes)))
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Blame"
}
# What a station or a person says in words that do not change, which the page looks up.
WORDS = {
    *(text for kind in ALARMS.values() for text in (kind.title, kind.what_to_do)),
    *(text for measure in MEASURES for text in (measure.title, measure.what_to_do)),
    *BLAMES,
    *("ignored", "of", *get_args(RegionKind), "no region is drawn any more"),
    *(str(one.value) for kinds in (Kind, Cause, GelState, Reason) for one in kinds),
    *get_args(StatePayload.model_fields["state"].annotation),
    *("error", "incomplete", "damaged", "cannot tell"),
}

# The elements whose text is wider than they are, and the height of the verdict beside that of its letters.
CUT = (
    "[...document.querySelectorAll('button, h1, h2, p, th, td, aside, #state')]"
    ".filter((one) => one.clientWidth && one.scrollWidth > one.clientWidth + 1).map((one) => one.textContent)"
)
VERDICT = """(() => { const verdict = document.getElementById('verdict');
  return [verdict.offsetHeight, parseFloat(getComputedStyle(verdict).fontSize)]; })()"""


class Texts(HTMLParser):
    """The texts of page.html, and what is read of its elements. What has translate="no" names languages."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()
        self.left_out: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found |= {value for name in ("aria-label", "alt") if (value := given.get(name))}
        if tag in ("title", "noscript", "script") or given.get("translate") == "no":
            self.left_out.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self.left_out[-1:] == [tag]:
            self.left_out.pop()

    def handle_data(self, data: str) -> None:
        if not self.left_out and re.search("[A-Za-z]", data):
            self.found.add(data.strip())


def texts() -> set[str]:
    """Return every English text of the page."""
    html = Texts()
    html.feed((FILES / "page.html").read_text(encoding="utf-8"))
    return html.found | set(re.findall(r'\bt\("((?:[^"\\]|\\.)*)"', SCRIPT)) | WORDS


def catalogue(language: str) -> dict[str, str]:
    return dict(json.loads((FILES / f"words_{language}.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_is_missing_or_unused_and_each_keeps_its_values(language: str) -> None:
    """A text that is not in the catalogue would be English between the others."""
    words = catalogue(language)

    assert (texts() - set(words), set(words) - texts()) == (set(), set())
    fields = re.compile(r"\{\w+\}|`[^`]+`")  # values, and what is typed
    assert [
        text for text in words if sorted(fields.findall(text)) != sorted(fields.findall(words[text]))
    ] == []
    assert [text for text, word in words.items() if not word.strip()] == []


def test_no_sentence_of_the_script_is_outside_of_the_catalogue() -> None:
    """Two words of a literal that no `t(...)` looks up, and a word that is shown as it stands."""
    plain = re.sub(r'\bt\("(?:[^"\\]|\\.)*"', "t(", re.sub(r"^\s*//.*$", "", SCRIPT, flags=re.MULTILINE))
    plain = re.sub(r"\$\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", "", plain)
    literals = [one or other for one, other in re.findall(r'"([^"\n]*)"|`([^`\n]*)`', plain)]
    sentences = [text for text in literals if re.search(r"[A-Za-z]{2,} [A-Za-z×]{2,}", text)]
    shown = re.findall(r'(?:put|say|element)\([^()]*?, "([A-Za-z][^"]*)"\)', plain)

    assert set(sentences) - {"use strict", "not proven", "[translate=no], noscript, script"} == set()
    assert set(shown) == set()


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("size", [(390, 844), (1280, 800)], ids=["phone", "desk"])
def test_the_page_speaks_the_language_of_the_browser_and_nothing_is_cut(
    browser: Any, language: str, size: tuple[int, int]
) -> None:
    """Its verdict, gel and headings; a switch goes to English and is remembered."""
    words = catalogue(language)
    context = browser.new_context(locale=language, viewport={"width": size[0], "height": size[1]})
    tab = context.new_page()
    tab.set_default_timeout(BROWSER_MS)
    with served(SCENES["page"]) as port:
        tab.goto(f"http://127.0.0.1:{port}/")
        tab.wait_for_selector("#verdict.fail")
        tab.fill("#token", TOKEN)
        tab.press("#token", "Enter")
        tab.wait_for_selector("#new-gel", state="visible")

        assert tab.inner_text("#verdict").lower() == words["fail"].lower()
        assert tab.inner_text("#gel-title") == words["Gel"]
        assert words["due"] in tab.inner_text("#gel")
        said = tab.inner_text("#alarms .alarm p")
        assert said.startswith(f"{words[ALARMS['gel'].title]}\ngel S-1 is due: 812 of 1000 presses")
        assert words[ALARMS["gel"].what_to_do].replace("`", "") in said
        assert tab.get_attribute("html", "lang") == language
        assert tab.get_attribute("#press", "aria-label") == words["Last press"]
        assert tab.evaluate("document.scrollingElement.scrollWidth <= innerWidth")
        assert tab.evaluate(CUT) == []
        height, size_px = tab.evaluate(VERDICT)
        assert height < 2 * size_px

        tab.select_option("#language", "en")
        wait_until(tab, "document.getElementById('verdict').textContent === 'fail'")
        tab.reload()
        tab.wait_for_selector("#verdict.fail")
        assert tab.inner_text("#gel-title") == "Gel"
        assert tab.inner_text("#receivers-title") == "Receivers"
    context.close()


def test_a_rejected_press_says_why_in_the_language(browser: Any) -> None:
    """By the reason's code; what is beside the part, and why it fails, are sentences of the catalogue or English."""
    context = browser.new_context(locale="de", viewport={"width": 1280, "height": 800})
    tab = context.new_page()
    tab.set_default_timeout(BROWSER_MS)
    rejected = press(
        6, verdict=Kind.REJECTED, score=None, score_ratio=None, reason="off_position: press again"
    )
    blamed = press(7, verdict=Kind.FAIL, cause=Cause.PART, cause_text="no mark of the free gel explains it")
    for messages, selector, words in (
        (rejected, "#why", "liegt nicht an seiner Stelle: press again"),
        (blamed, "#cause", "keine Marke des freien Gels erklärt es"),
    ):
        with served(Scene((*READY, *messages))) as port:
            tab.goto(f"http://127.0.0.1:{port}/")
            tab.locator(selector, has_text=words).wait_for()
    context.close()
