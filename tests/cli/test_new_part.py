"""`gelgate new-part`: from good pieces on the virtual sensor to verdicts, and where it goes on."""

import io
import re
import sys
from functools import partial
from pathlib import Path

import pytest
from command_line import gelgate
from station import press_recording

from calibration.acquisition.arguments import AcquireArguments
from edge.config import load_config


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight good presses."""
    return press_recording(tmp_path_factory.mktemp("recording") / "presses", 8)


def test_the_same_command_goes_on_until_the_station_inspects(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other_package: None
) -> None:
    """Eight presses promise 25 %, not 10 %: it says so. With a promise that they keep they are not taken again."""
    monkeypatch.chdir(tmp_path)
    tiny = partial(AcquireArguments, method="tiny", backbone="tiny")  # what it fits by itself takes long
    monkeypatch.setattr("calibration.acquisition.new_part.AcquireArguments", tiny)
    words = ("bolt/pos1", "--yes", "--device", "usb_mock", "--option", f"recording={recording}")
    asked = gelgate("new-part", *words, "--option", "pace=0")
    assert asked.code == 3
    assert (
        "8 presses of bolt do not keep the promise of at most 10 % false alarms; press more"
        in asked.sentence()
    )
    assert "not done: presses; the same command goes on from here" in asked.err
    assert load_config(Path("gelgate.toml")).device.options == {"recording": str(recording), "pace": 0}

    done = gelgate("new-part", *words, "--promise", 0.3)

    assert done.code == 0, done.err
    assert "presses/bolt-pos1 has 8 presses already; they count" in done.out
    assert re.findall(r"^\d of 4: (\w+)$", done.out, re.MULTILINE) == ["sensor", "presses", "fit", "check"]
    assert re.search(
        r"^bolt/pos1 is ready after \d+ s: sensor \d+ s, presses \d+ s, fit \d+ s, check", done.out, re.M
    )
    assert len(re.findall(r" bolt/pos1  (?:PASS|FAIL) ", done.out)) == 8

    again = gelgate("new-part", "bolt/pos1", "--yes")
    assert again.code == 0, again.err
    assert "bundles/bolt-pos1 is there already" in again.out
    assert "8 presses: " in again.out


class Typed(io.StringIO):
    """A terminal at which these lines are typed."""

    def isatty(self) -> bool:
        return True


STATION = (
    '[device]\nplugin = "usb_mock"\noptions = { recording = "." }\n[inspection]\nbundle = "bundles/nut"\n'
)
LOST = '[[sinks]]\nplugin = "mqtt"\noptions = { host = "a..b" }\n'
VIRTUAL = ("--device", "usb_mock", "--option", "recording=RECORDING")


@pytest.mark.parametrize(
    ("words", "typed", "station", "sentence"),
    [
        (("a/b/c", "--yes", *VIRTUAL), "", "", "'a/b/c' is no name of a part, expected a word"),
        (("..", "--yes", *VIRTUAL), "", "", "'..' is no name of a part, expected a word"),
        (("/pos1", "--yes", *VIRTUAL), "", "", "'/pos1' is no name of a part, expected a word"),
        (("a\nb", "--yes", *VIRTUAL), "", "", "'a\\nb' is no name of a part, expected a word"),
        (("x" * 129, "--yes", *VIRTUAL), "", "", "xx' is no name of a part, expected a word"),
        (("bolt", *VIRTUAL), None, "", "needs an answer and there is no terminal; add --yes for 'none'"),
        (("bolt", "--option", "pace=0"), "", "", "--option belongs to one plugin; name it with --device"),
        (("bolt", "--device", "lamp"), "", "", "lamp"),
        (("bolt", "--yes"), "", STATION, "names no bundle bolt; write bundle_folder"),
        (
            ("bolt", "--yes", "--device", "recorded"),
            "",
            STATION,
            "names the device plugin usb_mock, found --device",
        ),
        (("bolt", "--yes", "--promise", "2"), "", STATION, "--promise lies between 0 and 1, found 2"),
        (
            ("nut", "--yes"),
            "",
            STATION + LOST,
            "'a..b' cannot be the name of a host; correct sinks.0.options.host",
        ),
        (
            ("bolt", "--yes", "--device", "recorded", "--option", "recording=absent"),
            "",
            "",
            "no sensor was found",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(
    words: tuple[str, ...],
    typed: str | None,
    station: str,
    sentence: str,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And no bundle is made. A wrong word of the command begins no step: the same command would not go on."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO() if typed is None else Typed(typed))
    if station:
        Path("gelgate.toml").write_text(f'version = 1\n{station}[[sinks]]\nplugin = "memory"\n')

    refused = gelgate("new-part", *(word.replace("RECORDING", str(recording)) for word in words))

    assert refused.code in (3, 4)
    assert sentence in refused.sentence()
    is_word = any(one in sentence for one in ("no name of a part", "lamp", "--promise"))
    assert ("not done: sensor" in refused.err) is not is_word
    assert not Path("bundles").exists()


def test_a_bad_answer_is_asked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of it is written: with a port that is none in the configuration no repetition would go on."""
    monkeypatch.chdir(tmp_path)
    brokers, pressed = (
        ("a..b", "plant:mqtt", ":1883", "plant 1", "plant:99999", "plant:0"),
        ("twice", "0", "101"),
    )
    lines = "\n".join((*brokers, "localhost:1884", *pressed, "3", "perhaps", "n", ""))
    monkeypatch.setattr(sys, "stdin", Typed(lines))
    recording = str(press_recording(tmp_path / "recording", 3))
    words = [word.replace("RECORDING", recording) for word in VIRTUAL]
    refused = gelgate("new-part", "bolt", *words, "--option", "pace=0")

    assert re.findall("'(.*)' is no broker", refused.out) == [*brokers]
    assert re.findall("'(.*)' is no answer", refused.out) == [*pressed, "perhaps"]
    assert "3 presses of bolt do not keep the promise" in refused.sentence()
    assert load_config(Path("gelgate.toml")).sinks[1].options == {"host": "localhost", "port": 1884}
