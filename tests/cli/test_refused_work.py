"""Every other verb on bad input: a sentence, the documented exit code, no traceback."""

import errno
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import typer
from breakable_station import Bench
from command_line import gelgate
from small_recordings import write_recording

from calibration.fitting.fit import Fitted
from edge import cli, registry
from edge.core.errors import ConfigError, StoreError
from edge.messaging import local_broker
from edge.store.press_store import Store


def picture(path: Path, width: int, height: int) -> None:
    path.parent.mkdir(exist_ok=True)
    rng = np.random.default_rng(width)
    cv2.imwrite(str(path), rng.integers(0, 255, (height, width, 3), dtype=np.uint8))


def record_over_something(bench: Bench) -> list[object]:
    write_recording(bench.folder / "old", 1)
    options = ["recording=presses", "pace=0"]
    return ["record", "old", "--device", "recorded", *(x for o in options for x in ("--option", o))]


def fit_empty(bench: Bench) -> list[object]:
    (bench.folder / "empty").mkdir()
    return fit("empty")


def fit_mixed(bench: Bench) -> list[object]:
    picture(bench.folder / "mixed/a.png", 320, 240)
    picture(bench.folder / "mixed/b.png", 100, 90)
    return fit("mixed")


def fit_unreadable(bench: Bench) -> list[object]:
    picture(bench.folder / "torn/a.png", 320, 240)
    content = (bench.folder / "torn/a.png").read_bytes()
    (bench.folder / "torn/b.png").write_bytes(content[: len(content) // 2])
    (bench.folder / "torn/c.jpg").write_bytes(b"a letter")
    return fit("torn")


def fit_link_to_nothing(bench: Bench) -> list[object]:
    picture(bench.folder / "linked/a.png", 320, 240)
    (bench.folder / "linked/b.png").symlink_to("/nowhere/b.png")
    (bench.folder / "linked/c.webp").write_bytes(b"RIFF")
    (bench.folder / "linked/notes.txt").write_text("dear reader")
    return fit("linked")


def fit_over_own_pictures(bench: Bench) -> list[object]:
    picture(bench.folder / "own/a.png", 320, 240)
    return [*fit("own"), "-o", "own", "--overwrite"]


def fit_over_a_project(bench: Bench) -> list[object]:
    (bench.folder / "web").mkdir()
    (bench.folder / "web/manifest.json").write_text('{"name": "my web page"}')
    (bench.folder / "web/thesis.tex").write_text("ten years")
    return [*fit("presses"), "-o", "web", "--overwrite"]


def fit_over_a_bundle_with_more(bench: Bench) -> list[object]:
    bench.bundle("kept")
    (bench.folder / "kept/notes").mkdir()
    (bench.folder / "kept/notes/thesis.tex").write_text("ten years")
    return [*fit("presses"), "-o", "kept", "--overwrite"]


def fit_over_a_zip(bench: Bench) -> list[object]:
    with zipfile.ZipFile(bench.folder / "web.zip", "w") as archive:
        archive.writestr("thesis.tex", "ten years")
    return [*fit("presses"), "-o", "web.zip", "--overwrite"]


def fit_free_gel_alone(bench: Bench) -> list[object]:
    picture(bench.folder / "same/a.png", 320, 240)
    return fit("same", "--no-contact", "same")


def fit_huge(bench: Bench) -> list[object]:
    """The head of a BMP file that claims 60,000 pixels a side."""
    (bench.folder / "huge").mkdir()
    sizes = struct.pack("<IiiHHIIiiII", 40, 60_000, 60_000, 1, 24, 0, 0, 0, 0, 0, 0)
    (bench.folder / "huge/a.bmp").write_bytes(
        b"BM" + struct.pack("<IHHI", 1000, 0, 0, 54) + sizes + bytes(946)
    )
    return fit("huge")


def fit(source: str, *more: object) -> list[object]:
    return ["fit", source, "-o", "made", "--part", "bolt", *more]


def verify_changed(bench: Bench) -> list[object]:
    array = next((bench.bundle("changed") / "bank").iterdir())
    array.write_bytes(array.read_bytes()[:-1] + b"\x01")
    return ["bundle", "verify", "changed"]


def verify_other_scores(bench: Bench) -> list[object]:
    """Hashes agree, golden frames do not."""
    import tiny

    from edge.model.bundle import GoldenFrame
    from edge.model.bundle_writer import write_bundle

    golden = GoldenFrame(tiny.presses(1)[0], "a press", 9.0, tuple((9.0,) * 8 for _ in range(8)))
    write_bundle(bench.folder / "off", tiny.tiny_files(golden=[golden])[1])
    return ["bundle", "verify", "off"]


def database(bench: Bench) -> list[object]:
    (bench.folder / "letter.db").write_bytes(b"dear reader " * 900)
    return ["gel", "show", "--database", "letter.db"]


def known_sensor(bench: Bench) -> list[object]:
    with Store(bench.folder / "gelgate.db") as store:
        store.gel("TEST0001", 10**18)
    return ["gel", "replace", "--database", "gelgate.db", "--serial", "TEST0010"]


REFUSED: dict[str, tuple[Callable[[Bench], list[object]], int, tuple[str, ...]]] = {
    "record over something": (record_over_something, 3, ("old is not an empty folder", "never written over")),
    "record from nothing": (
        lambda _: ["record", "new", "--device", "recorded", "--option", "recording=absent"],
        3, ("absent does not exist", "gelgate record"),
    ),
    "record without a sensor's name": (lambda _: ["record", "new"], 3, ("--device", "--from-images")),
    "record from no images": (
        lambda _: ["record", "new", "--from-images", "absent"], 3, ("absent is not a folder of press images",),
    ),
    "record where nothing can be made": (
        lambda _: ["record", "/proc/no", "--device", "recorded", "--option", "recording=presses"],
        1, ("/proc/no cannot be started", "choose another folder"),
    ),
    "a wrong option": (
        lambda _: ["record", "new", "--device", "recorded", "--option", "recordng=presses"],
        3, ("'recordng' is not known; did you mean 'recording'?", "it takes: recording, pace, loop"),
    ),
    "devices of no plugin": (
        lambda _: ["devices", "--device", "usb_mok"], 3, ("'usb_mok'", "did you mean 'usb_mock'?"),
    ),
    "fit from an empty folder": (fit_empty, 3, ("empty is neither a recording", ".png", "name the folder")),
    "fit from nothing": (lambda _: fit("absent"), 3, ("there is nothing at absent", "check the path")),
    "fit from nothing, of no part": (
        lambda _: ["fit", "absent", "-o", "new"], 3, ("there is nothing at absent", "check the path"),
    ),
    "fit from mixed sizes": (
        fit_mixed, 3, ("1 of 2 pictures", "b.png: is 100x90", "takes 3280x2464 (camera) or 320x240"),
    ),
    "fit from unreadable pictures": (
        fit_unreadable, 3, ("2 of 3 pictures", "b.png: ends early", "c.jpg: is not a picture"),
    ),
    "fit from a folder that is not all pictures": (
        fit_link_to_nothing, 3, ("linked holds what cannot be read as a picture (b.png, c.webp)", "a link to nothing"),
    ),
    "fit over its own pictures": (
        fit_over_own_pictures, 3, ("own is a folder that holds no bundle, and is not replaced; choose another name",),
    ),
    "fit over a folder whose manifest.json is another program's": (
        fit_over_a_project, 3, ("web is no bundle, and is not replaced", "manifest.json is not a gelgate manifest"),
    ),
    "fit over a bundle beside which there is more": (
        fit_over_a_bundle_with_more, 3, ("kept holds notes/thesis.tex, which is no file of its bundle",),
    ),
    "fit over a zip that is no bundle": (fit_over_a_zip, 3, ("web.zip is no bundle, and is not replaced",)),
    "write a graph over a folder": (
        lambda _: ["export", "merge", "bundle", "-o", "presses", "--overwrite"], 3, ("presses is a folder, and a file",)
    ),
    "fit from the pictures of the free gel alone": (
        fit_free_gel_alone, 3, ("every picture of the presses is given as one of the free gel too",),
    ),
    "fit from a picture that claims to be huge": (fit_huge, 3, ("a.bmp: is not a picture that can be decoded",)),
    "fit over a bundle": (
        lambda _: ["fit", "presses", "-o", "bundle", "--part", "x"], 3, ("bundle exists already", "--overwrite"),
    ),
    "fit into a file": (
        lambda _: fit("presses", "-o", "presses/recording.toml/made"),
        3, ("presses/recording.toml is no folder to write in; choose another place",),
    ),
    "fit over a file": (
        lambda _: fit("presses", "-o", "presses/recording.toml", "--overwrite"),
        3, ("presses/recording.toml is a file, not a bundle, and is not replaced; choose another name",),
    ),
    "fit where no folder can be made": (
        lambda _: fit("presses", "-o", "/proc/no/made"), 3, ("/proc is no folder to write in",),
    ),
    "fit with a threshold that is none": (
        lambda _: fit("presses", "--threshold", "nan"), 3, ("a threshold is a finite number, found nan",),
    ),
    "fit with an unknown method": (lambda _: fit("presses", "--method", "padin"), 3, ("did you mean 'padim'?",)),
    "fit with an unknown parameter": (
        lambda _: fit("presses", "--set", "rnk=3"), 3,
        ("the fit and padim have no such parameter; did you mean 'rank'?",),
    ),
    "a list where a number is meant": (
        lambda _: fit("presses", "--set", "rank=[1]"), 3, ("padim: 'rank' is [1]: Input should be a valid integer",),
    ),
    "fit of a region outside": (
        lambda _: fit("presses", "--region", "300,0,64x64", "--profile", "cropped_lr"),
        3, ("outside the picture of 320x240", "move or shrink it"),
    ),
    "verify of nothing": (lambda _: ["bundle", "verify", "absent"], 5, ("no bundle at absent", "gelgate fit")),
    "verify of a recording": (lambda _: ["bundle", "verify", "presses"], 5, ("presses: manifest.json is missing",)),
    "verify of a changed bank": (verify_changed, 5, ("has SHA-256", "copy the complete bundle again")),
    "verify of other scores": (verify_other_scores, 5, ("golden frame 0 (a press) scores", "9")),
    "inspect of nothing": (lambda _: ["bundle", "inspect", "absent"], 3, ("no bundle at absent",)),
    "gels of no database": (lambda _: ["gel", "show", "--database", "absent.db"], 3, ("absent.db does not exist",)),
    "gels of a letter": (database, 1, ("letter.db", "file is not a database", "name another file")),
    "a new gel for a sensor never seen": (
        known_sensor, 3, ("no gel of a sensor 'TEST0010' is in the ledger", "did you mean 'TEST0001'?"),
    ),
    "gels of an unknown gateway": (lambda _: ["gel", "show"], 3, ("gelgate.toml does not exist", "gelgate check")),
    "watch without a broker": (
        lambda _: ["watch", "--host", "127.0.0.1", "--port", "1", "--timeout", "1"],
        4, ("no broker answers at 127.0.0.1:1", "correct host and port"),
    ),
    "a scene that is none": (
        lambda _: ["lab", "simulate", "dmeo", "-o", "out"], 3, ("no scene is named 'dmeo'; did you mean 'demo'?",),
    ),
    "evaluate on nothing": (lambda _: ["evaluate", "bundle", "absent"], 3, ("'absent' is not a folder",)),
    "a demo where nothing can be written": (lambda _: ["demo", "-o", "/proc/no"], 1, ("/proc/no", "check the path")),
}  # fmt: skip


@pytest.mark.parametrize(("command", "code", "words"), REFUSED.values(), ids=REFUSED)
def test_bad_input_is_a_sentence(
    bench: Bench, command: Callable[[Bench], list[object]], code: int, words: tuple[str, ...]
) -> None:
    """One sentence that names the thing, what was found and what to do; one exit code."""
    ended = gelgate(*command(bench))

    assert ended.code == code, ended.err
    sentence = ended.sentence()
    assert [word for word in words if word not in sentence] == [], sentence
    assert not (bench.folder / "made").exists()
    assert not (bench.folder / "absent.db").exists()  # a mistyped path does not become an empty ledger


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.ENOTDIR])
def test_only_a_full_disk_asks_for_space(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("calibration.fitting.fit_config.write_bundle", refuse)
    with pytest.raises(StoreError) as refused:
        Fitted(Mock(), {}).write(Path("made"))
    assert ("free some space" in str(refused.value)) == (number == errno.ENOSPC)


def test_a_demo_without_a_broker_says_so_before_work(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither mosquitto nor amqtt: exit code 4 and what to install, and nothing was simulated."""
    monkeypatch.setattr("shutil.which", lambda *_, **__: None)
    monkeypatch.setattr(local_broker, "find_spec", lambda _: None)
    ended = gelgate("demo", "-o", "out")

    assert ended.code == 4
    assert ended.sentence() == (
        "no MQTT broker is installed here (wanted: mosquitto or amqtt); install mosquitto, or pip install amqtt"
    )
    assert ended.out == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rnu"], "No such command 'rnu'"),
        (["run", "--presess", "3"], "--presses"),
        (["run", "--presses", "many"], "Invalid value for '--presses'"),
        (["fit", ".", "-o", "x"], "Missing option '--part'"),
    ],
)
def test_a_wrong_command_line_ends_with_2(arguments: list[str], words: str) -> None:
    """Usage faults have another exit code than faults of the input."""
    ended = gelgate(*arguments)

    assert ended.code == 2
    assert words in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.parametrize("name", ["pipe", "/dev/zero"])
def test_a_pipe_or_a_device_is_not_read(name: str, bench: Bench) -> None:
    """A verb would wait for what comes out of it, or read for ever."""
    if name == "pipe":
        os.mkfifo(bench.folder / name)
    for words in (["check", "-c"], ["fit"], ["export", "detect"], ["gel", "show", "--database"]):
        ended = gelgate(*words, name)

        assert ended.code == 2
        assert f"{name} is neither a file nor a folder" in ended.sentence()


def ending_with(error: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb `topics` now fails in that way."""

    def verb() -> None:
        raise error

    app = typer.Typer()
    app.callback()(lambda: None)
    app.command("topics")(verb)
    monkeypatch.setattr(cli, "build", lambda: app)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "gelgate: interrupted\n"),
        (PermissionError(errno.EACCES, "Permission denied", "/etc/x"), 1, "gelgate: /etc/x: Permission denied; "),
        (OSError(errno.ENOSPC, "No space left on device"), 1, "gelgate: the disk: No space left on device; "),
        (FileNotFoundError(errno.ENOENT, "No such file"), 1, "gelgate: the folder where this was started: No such "),
    ],
)  # fmt: skip
def test_how_else_a_verb_may_end(
    error: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C, a path that refuses and a full disk are reported in one line, for every verb."""
    ending_with(error, monkeypatch)
    ended = gelgate("topics")

    assert ended.code == code
    assert ended.err.strip().startswith(said.strip())


def test_a_fault_of_ours_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault of gelgate is not reported as one of the operator, the machine or the broker."""
    ending_with(OSError(errno.EINVAL, "Invalid argument"), monkeypatch)

    with pytest.raises(OSError, match="Invalid argument"):
        gelgate("topics")


@pytest.mark.parametrize("value", ["no_such_package.lamp:plugin", "json:no_such_plugin"])
def test_a_plugin_not_imported_says_what_to_install(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An entry point without its target is a sentence, not an ImportError or an AttributeError."""
    from importlib.metadata import EntryPoint

    broken = EntryPoint("lamp", value, "gelgate.devices")
    monkeypatch.setattr(registry, "_points", lambda group: {"lamp": [broken]})
    with pytest.raises(ConfigError, match=r"'lamp' .* cannot be loaded: .*no_such_p.*pip install"):
        registry.device("lamp")
