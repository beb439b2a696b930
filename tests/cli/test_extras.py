"""Without the extra that it needs a verb refuses at its start: nothing is read, computed or written before."""

import sys
from pathlib import Path

import pytest
from command_line import gelgate

from edge.extras import needs

VERBS = {
    "lab train-backbone run": ("train", "torch"),
    "lab msa report": ("studies", "jinja2 and scipy"),
}


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder to work in, where no package of an extra can be imported."""
    for name in ("torch", "jinja2", "scipy", "sklearn", "amqtt"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("line", VERBS)
def test_a_verb_names_its_extra_before_it_begins(plain: Path, line: str) -> None:
    """Which packages, which extra; even a file that is not there is not looked for."""
    extra, packages = VERBS[line]
    done = gelgate(*line.split())

    assert done.code == 3
    assert f"needs {packages}, not installed here; pip install 'gelgate[{extra}]'" in done.sentence()
    assert list(plain.iterdir()) == []


def test_what_is_installed_is_not_refused() -> None:
    needs("studies", "this test")
    with pytest.raises(KeyError):
        needs("exprot", "a misspelt extra")
