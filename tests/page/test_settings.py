"""Where the page is served: options that cannot work, and the token."""

import os
from pathlib import Path

import pytest
from page_messages import ROOT

from edge.core.errors import ConfigError
from edge.core.plugins import HasWarnings
from edge.core.sink_context import Station
from edge.page.settings import PageSettings
from plugins.sinks.page import PageOptions, plugin


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bind": "0.0.0.0"}, "bind = '0.0.0.0' needs allow_from"),
        ({"allow_from": ["192.168.1.0/24"]}, "allow_from needs bind: no other machine reaches 127.0.0.1"),
        ({"bind": "gateway"}, "expected an address of this machine"),
        ({"bind": "::", "allow_from": ["192.168.1.1/24"]}, "has host bits set"),
        ({"names": ["http://gateway"]}, "names"),
        ({"token_file": "a", "token_variable": "B"}, "in token_file or in token_variable, not in both"),
        ({"port": 80}, "port"),
        ({"tokenfile": "a"}, "tokenfile"),
    ],
)
def test_options_that_cannot_work_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words.replace("[", "\\[")):
        PageSettings.model_validate(options)


def test_the_token_is_in_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blanks around it do not count; without both there is none, and a variable that is not set is named."""
    (tmp_path / "token").write_bytes(b" correct-horse\n")
    (tmp_path / "token").chmod(0o640)
    monkeypatch.delenv("PAGE_TOKEN", raising=False)

    assert PageSettings().token() is None
    assert PageSettings(token_file=tmp_path / "token").token() == b"correct-horse"
    with pytest.raises(ConfigError, match="the environment variable PAGE_TOKEN holds 0 bytes"):
        PageSettings(token_variable="PAGE_TOKEN").token()
    monkeypatch.setenv("PAGE_TOKEN", "battery-staple")
    assert PageSettings(token_variable="PAGE_TOKEN").token() == b"battery-staple"


@pytest.mark.parametrize(
    ("content", "rights", "words"),
    [
        (None, 0o640, "cannot be read"),
        (b"short", 0o640, "holds 5 bytes, at least 8 are needed"),
        (b"correct-horse", 0o644, "is open to every user; set its rights to 0640"),
    ],
)
def test_a_token_that_cannot_be_used_stops_the_start(
    tmp_path: Path, content: bytes | None, rights: int, words: str
) -> None:
    """`gelgate check` finds it too. The sentence does not hold it."""
    path = tmp_path / "token"
    if content is not None:
        path.write_bytes(content)
        path.chmod(rights)
    options = PageOptions(token_file=path, port=1024)

    with pytest.raises(ConfigError, match=words) as caught:
        options.warnings()
    assert "horse" not in str(caught.value)
    with pytest.raises(ConfigError, match=words):
        plugin.open(options, Station(ROOT, "press2"))


def test_a_check_says_that_nothing_is_encrypted(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the network; on this machine nobody reads it."""
    monkeypatch.setenv("PAGE_TOKEN", "battery-staple")
    plant = {"bind": "0.0.0.0", "allow_from": ("192.168.1.0/24",)}

    assert isinstance(PageOptions(), HasWarnings)
    assert PageOptions(token_variable="PAGE_TOKEN").warnings() == []
    assert PageOptions(**plant).warnings() == ["the page is not encrypted on the network"]
    assert (
        "its token can be read on the way" in PageOptions(**plant, token_variable="PAGE_TOKEN").warnings()[0]
    )


def test_a_pipe_is_no_token_file(tmp_path: Path) -> None:
    """A start would wait for what comes out of it."""
    os.mkfifo(tmp_path / "token", 0o640)

    with pytest.raises(ConfigError, match="it is a pipe, expected a file"):
        PageOptions(token_file=tmp_path / "token", port=1024).warnings()
