"""The operator's page in other languages: every text and every sentence of the station is in every catalogue, and none
is cut or left in English."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args

import pytest
from chromium import BROWSER_MS, open_tab, wait_until
from page_messages import press
from page_pictures import READY, SCENES, TOKEN, Scene, served
from station_sentences import find_sentences

from edge.core.contact.events import NotSettledReason
from edge.core.drawn_regions import RegionKind
from edge.core.drift import MEASURES
from edge.core.gel_life import GelState
from edge.core.imaging.quality import Reason
from edge.core.reference_press.charts import MEASURES as CHARTED
from edge.core.verdict import Cause, Kind
from edge.messaging.alarm_payload import ALARMS
from edge.messaging.status_payloads import StatePayload
from edge.page.server import LANGUAGES

FILES = Path(__file__).resolve().parents[2] / "edge" / "page" / "files"
SCRIPT = (FILES / "page.js").read_text(encoding="utf-8")
# What a station or a person says in words that do not change, which the page looks up.
WORDS = {
    *(text for kind in ALARMS.values() for text in (kind.title, kind.what_to_do)),
    *("ignored", "of", "contact", *get_args(RegionKind), "no region is drawn any more"),
    *(str(one.value) for kinds in (Cause, GelState, Reason) for one in kinds),
    *get_args(StatePayload.model_fields["state"].annotation),
    *("error", "incomplete", "damaged", "cannot tell", "levels"),
}
# The words that stand in the places of patterns; a name of a part is looked up among nothing else.
PLACED = {
    *(text for measure in (*MEASURES, *CHARTED) for text in (measure.title, measure.what_to_do)),
    *(one.value for kinds in (Kind, NotSettledReason) for one in kinds),
}
FIELDS = re.compile(r"\{\w+\}|`[^`]+`")  # values, and what is typed
GEL_DUE = {
    "de": "Gel S-1 ist fällig: 812 von 1000 Pressungen",
    "it": "il gel S-1 è in scadenza: 812 di 1000 pressate",
    "ja": "ゲルS-1は交換時期です：1000回中812回",
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


def catalogue(language: str) -> dict[str, Any]:
    return dict(json.loads((FILES / f"words_{language}.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_is_missing_or_unused_and_each_keeps_its_values(language: str) -> None:
    """A text that is not in the catalogue would be English between the others."""
    words = catalogue(language)
    sentences = words.pop("sentences")
    patterns, not_literal = find_sentences()
    known = patterns | PLACED

    assert (texts() - known - set(words), set(words) - texts() | set(words) & known) == (set(), set())
    assert (known - set(sentences), set(sentences) - known) == (set(), set())
    both = {**words, **sentences}
    assert [text for text in both if sorted(FIELDS.findall(text)) != sorted(FIELDS.findall(both[text]))] == []
    assert [text for text, word in both.items() if not word.strip()] == []
    assert not_literal == set()
    assert [text for text in patterns if not re.search("[A-Za-z]", FIELDS.sub("", text))] == []


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
def test_the_page_speaks_the_language_of_the_browser_and_nothing_is_cut(browser: Any, language: str) -> None:
    """Its verdict, gel and headings, on a desk and on a phone; a switch goes to English and is remembered."""
    words = catalogue(language)
    context = browser.new_context(locale=language, viewport={"width": 1280, "height": 800})
    tab = context.new_page()
    tab.set_default_timeout(BROWSER_MS)
    with served(SCENES["page"]) as port:
        tab.goto(f"http://127.0.0.1:{port}/")
        tab.wait_for_selector("#verdict.fail")
        tab.fill("#token", TOKEN)
        tab.press("#token", "Enter")
        tab.wait_for_selector("#new-gel", state="visible")

        assert tab.inner_text("#verdict").lower() == words["sentences"]["fail"].lower()
        assert tab.inner_text("#gel-title") == words["Gel"]
        assert words["due"] in tab.inner_text("#gel")
        said = tab.inner_text("#alarms .alarm p")
        assert said.startswith(words[ALARMS["gel"].title] + "\n" + GEL_DUE[language])
        assert words[ALARMS["gel"].what_to_do].replace("`", "") in said
        assert tab.get_attribute("html", "lang") == language
        assert tab.get_attribute("#press", "aria-label") == words["Last press"]
        for width, height in ((1280, 800), (390, 844)):
            tab.set_viewport_size({"width": width, "height": height})
            assert tab.evaluate("document.scrollingElement.scrollWidth <= innerWidth")
            assert tab.evaluate(CUT) == []
            height_px, size_px = tab.evaluate(VERDICT)
            assert height_px < 2 * size_px

        tab.select_option("#language", "en")
        wait_until(tab, "document.getElementById('verdict').textContent === 'fail'")
        tab.reload()
        tab.wait_for_selector("#verdict.fail")
        assert tab.inner_text("#gel-title") == "Gel"
        assert tab.inner_text("#receivers-title") == "Receivers"
    context.close()


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_sentence_of_the_station_is_found_by_its_words(browser: Any, language: str) -> None:
    """With its names and numbers, alone and between sentences that are not known; a name that is a word stays."""
    sentences = catalogue(language)["sentences"]

    def fill(text: str) -> str:
        return re.sub(r"\{(\w+)\}", r"<\1>", text)

    with served(Scene(READY)) as port:
        tab = open_tab(browser, port, locale=language)
        wait_until(tab, "patterns.length > 0")
        told = dict(
            zip(sentences, tab.evaluate("(all) => all.map(tell)", [*map(fill, sentences)]), strict=True)
        )
        due = "gel part is due: 1 of 2 presses; then `gelgate gel replace`"
        joined = tab.evaluate("tell", f"mqtt: no; {due}; no mark of the free gel explains it; constructor")
        tab.close()

    assert {text: said for text, said in told.items() if said != fill(sentences[text])} == {}
    first, end = (
        GEL_DUE[language].replace("S-1", "part").replace("812", "1").replace("1000", "2"),
        "; constructor",
    )
    assert joined.startswith(f"mqtt: no; {first}")
    assert joined.endswith(f"; {sentences['no mark of the free gel explains it']}{end}")


def test_a_rejected_press_says_why_in_the_language(browser: Any) -> None:
    """By the reason's code and sentence; what the catalogue does not have is English."""
    context = browser.new_context(locale="de", viewport={"width": 1280, "height": 800})
    tab = context.new_page()
    tab.set_default_timeout(BROWSER_MS)
    rejected = press(
        6,
        verdict=Kind.REJECTED,
        score=None,
        score_ratio=None,
        reason="stale: the frame is 1.25 s old, at most 1 s is accepted; check the machine's load",
    )
    blamed = press(7, verdict=Kind.FAIL, cause=Cause.PART, cause_text="no mark of the free gel explains it")
    for messages, selector, words in (
        (
            rejected,
            "#why",
            "altes Bild: das Bild ist 1.25 s alt, höchstens 1 s sind erlaubt; die Last des Rechners prüfen",
        ),
        (blamed, "#cause", "keine Marke des freien Gels erklärt es"),
    ):
        with served(Scene((*READY, *messages))) as port:
            tab.goto(f"http://127.0.0.1:{port}/")
            tab.locator(selector, has_text=words).wait_for()
    context.close()
