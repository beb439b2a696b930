"""`import gelgate`: its examples run, a score is the station's, bad input is a sentence, its surface is recorded."""

import doctest
import inspect
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from station import gel, jpeg, press_recording, station_config

import gelgate
from gelgate import interface

GOLDEN = Path(__file__).parents[1] / "compatibility/golden/interface.txt"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with presses of a part, a press of another piece, and a station that the examples' bundle serves."""
    folder = tmp_path_factory.mktemp("desk")
    press_recording(folder / "nominal", 6, seed=1)
    press_recording(folder / "line", 2, seed=2)
    (folder / "press.png").write_bytes(png(taken(3)))
    (folder / "gelgate.toml").write_text(
        station_config(folder, folder / "line", folder / "bundles/pz1").read_text()
    )
    return folder


@pytest.fixture(scope="module", autouse=True)
def at_the_desk(desk: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(desk)
        yield


@pytest.fixture(scope="module")
def examples(desk: Path) -> doctest.TestResults:
    """What the docstrings' examples gave; they leave a bundle."""
    runner, found = (
        doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL),
        doctest.DocTestFinder(),
    )
    tests = sorted(found.find(interface, "gelgate.interface"), key=lambda one: one.name)
    for one in tests:
        runner.run(one)
    return runner.summarize()


@pytest.fixture(scope="module")
def bundle(examples: doctest.TestResults) -> gelgate.Bundle:
    return gelgate.load("bundles/pz1")


def taken(seed: int, depth: float = 1.0, *, dent: bool = False) -> NDArray[np.uint8]:
    """A picture as a camera takes it, uint8 (240, 320, 3) RGB."""
    sent = np.frombuffer(jpeg(gel(np.random.default_rng(seed), depth, dent)), np.uint8)
    return np.ascontiguousarray(cv2.imdecode(sent, cv2.IMREAD_COLOR)[..., ::-1], np.uint8)


def png(rgb: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1].tobytes()


def test_the_examples_run(examples: doctest.TestResults) -> None:
    """Fit, load, score, an error, a station."""
    assert (examples.failed, examples.attempted > 8) == (0, True)


def test_damage_fails_and_the_free_gel_is_rejected(bundle: gelgate.Bundle) -> None:
    """The map is highest at the dent; a gel without a part is no pass."""
    press = bundle.score(taken(3, dent=True))
    free = bundle.score(taken(4, 0.0))

    assert (press.verdict, press.value is not None and press.value > bundle.threshold) == ("fail", True)
    assert press.map is not None
    x, y, *_ = bundle.region
    row, column = np.unravel_index(np.argmax(press.map), press.map.shape)
    assert np.hypot(column + x - 150, row + y - 100) < 30
    assert (free.verdict, free.value, free.map) == ("rejected", None, None)
    assert "nothing touches the gel" in free.reason


def test_a_file_and_its_pixels_have_one_score(bundle: gelgate.Bundle) -> None:
    """PNG is exact; the JPEG of a camera is read too."""
    Path("press.jpg").write_bytes(jpeg(gel(np.random.default_rng(3), 1.0)))

    assert bundle.score("press.png").value == bundle.score(taken(3)).value
    assert bundle.score(Path("press.jpg")).value == bundle.score(taken(3)).value


def test_a_fit_of_arrays_with_settings() -> None:
    """In memory, with an option and a parameter of the detector; nothing is left behind."""
    before = sorted(Path.cwd().iterdir())
    presses = [taken(seed) for seed in range(6)]
    settings = {"limit": "plain", "register": "never", "channels": 20}
    fitted = gelgate.fit(presses, part="PZ9", profile="cropped_lr", **settings)

    assert (fitted.part, fitted.method, fitted.score(presses[0]).verdict) == ("PZ9", "padim", "pass")
    assert sorted(Path.cwd().iterdir()) == before


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.zeros((240, 320, 3), np.float32), r"float32 \(240, 320, 3\), expected uint8 \(240, 320, 3\)"),
        (np.zeros((320, 240, 3), np.uint8), r"uint8 \(320, 240, 3\), expected uint8 \(240, 320, 3\)"),
        (np.zeros((240, 320), np.uint8), r"uint8 \(240, 320\), expected uint8 \(240, 320, 3\)"),
        ([[1, 2]], "the picture is of type list, expected a path or an array"),
        (None, "the picture is of type NoneType, expected a path or an array"),
        ("gelgate.toml", "gelgate.toml"),
        ("nowhere.jpg", "nowhere.jpg: cannot be opened"),
    ],
)
def test_what_is_no_picture_is_refused(bundle: gelgate.Bundle, picture: interface.Picture, said: str) -> None:
    """A sentence, and no score."""
    with pytest.raises(gelgate.GelgateError, match=said):
        bundle.score(picture)


@pytest.mark.parametrize(
    ("pictures", "settings", "said"),
    [
        ([], {}, "no press"),
        ([5], {}, "the picture is of type int, expected a path or an array"),
        ([np.zeros((4, 4), np.uint8)], {}, r"uint8 \(4, 4\), expected uint8 \(h, w, 3\)"),
        ("nominal", {"chanels": 5}, "channels"),
        ("nominal", {"limit": "best"}, "chosen or plain"),
        ("nominal", {"output": "line"}, "holds no bundle, and is not replaced"),
    ],
)
def test_what_cannot_be_fitted_is_refused(
    pictures: interface.Picture, settings: dict[str, object], said: str
) -> None:
    """A sentence, and no bundle."""
    with pytest.raises(gelgate.GelgateError, match=said):
        gelgate.fit(pictures, **settings)  # type: ignore[arg-type]


def describe(name: str, thing: object) -> Iterator[str]:
    """Lines of the surface: names, arguments with defaults and types, fields."""
    if inspect.isfunction(thing):
        yield f"{name}{inspect.signature(thing)}"
    elif isinstance(thing, property):
        yield f"{name} -> {inspect.signature(thing.fget or describe).return_annotation}"
    elif inspect.isclass(thing):
        yield f"class {name}({', '.join(base.__name__ for base in thing.__bases__)})"
        for field, kind in sorted(inspect.get_annotations(thing).items()):
            yield f"{name}.{field}: {kind}"
        for member, inner in sorted(vars(thing).items()):
            if not member.startswith("_"):
                yield from describe(f"{name}.{member}", inner)


def test_the_surface_is_the_recorded_one() -> None:
    """A change is one for every program that uses it: a line in CHANGELOG.md, a version by semver.org, `make
    golden`."""
    lines = [line for name in gelgate.__all__ for line in describe(name, getattr(gelgate, name))]
    if "GELGATE_GOLDEN" in os.environ:
        GOLDEN.write_text("\n".join([*lines, ""]))

    assert lines == GOLDEN.read_text().splitlines()


def test_the_import_is_light() -> None:
    """Neither arrays nor pydantic come before something is used; `gelgate --help` has its own test."""
    code = "import sys, gelgate; print(sorted({'numpy', 'cv2', 'pydantic', 'typer', 'edge'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert done.stdout.strip() == "[]"
    with pytest.raises(AttributeError, match="'gelgate' has no attribute 'sore'"):
        gelgate.sore  # noqa: B018
