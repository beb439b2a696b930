"""`gelgate lab detectability`: the smallest damage found, from pictures to the card in the bundle."""

import json
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import Outcome, gelgate
from pressed_dome import Bench, write

from edge.model.bundle import Bundle
from edge.model.detectability import DetectabilityCard, read_card

FAST = ("--kind", "dent", "--presses", 4, "--spacing", 3.1, "--threads", 1)


def run(bundle: Path, sources: Sequence[Path], output: Path, *more: object) -> Outcome:
    return gelgate("lab", "detectability", bundle, *sources, "-o", output, *FAST, *more)


def card(output: Path) -> DetectabilityCard:
    return DetectabilityCard.model_validate_json((output / "detectability.json").read_text())


def trials(output: Path) -> list[str]:
    return (output / "trials.jsonl").read_text().splitlines()


@pytest.fixture(scope="module")
def measured(fitted: Path, pictures: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A complete run on presses that the bundle has not learnt."""
    output = tmp_path_factory.mktemp("measured") / "out"
    return output, run(fitted, [pictures / "apart"], output, "--no-contact", pictures / "free")


def test_presses_apart_are_judged_by_the_bundle(measured: tuple[Path, Outcome]) -> None:
    """A dent on the dome is found somewhere between the sizes tried, and everything is written."""
    output, outcome = measured
    assert (outcome.code, outcome.err.count("gelgate:")) == (0, 0), outcome.err
    found = card(output)
    assert (found.judged_by, found.presses, len(found.places)) == ("presses apart", 4, 4)
    (dent,) = found.kinds
    assert dent.a90_mm is not None
    assert 0.008 < dent.a90_mm < 0.4
    assert dent.trials == len(trials(output)) == 16
    assert "dent: found in 90 % of cases, 95 % sure, from" in outcome.out
    picture = cv2.imread(str(output / "detectability.png"))
    assert picture is not None
    assert picture.shape[0] > 500
    assert "dent" in (output / "detectability.csv").read_text()


def test_learnt_presses_are_judged_by_banks_of_others(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """All presses of the fit: each is edited and judged by a bank of the others."""
    outcome = run(fitted, [pictures / "learnt"], tmp_path, "--no-contact", pictures / "free", "--spacing", 6)
    assert outcome.code == 0, outcome.err
    assert "each judged by a bank fitted without it" in outcome.out
    assert card(tmp_path).judged_by == "folds"


def test_an_interrupted_run_goes_on(
    measured: tuple[Path, Outcome], fitted: Path, pictures: Path, tmp_path: Path
) -> None:
    """With half of the trials done and a torn line, only the others are done, and the result is the same."""
    output, _ = measured
    kept = trials(output)
    (tmp_path / "trials.jsonl").write_text("\n".join(kept[:8]) + "\n" + kept[8][:20])
    outcome = run(fitted, [pictures / "apart"], tmp_path, "--no-contact", pictures / "free")
    assert outcome.code == 0, outcome.err
    assert trials(tmp_path) == kept
    assert card(tmp_path).kinds == card(output).kinds


def test_the_card_is_written_and_printed(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """The bundle keeps every file and field; only its facts gain the card, which `inspect` prints."""
    copy = Path(shutil.copytree(fitted, tmp_path / "bundle"))
    before = json.loads((copy / "manifest.json").read_text())
    assert gelgate("bundle", "keys", "new", tmp_path / "plant").code == 0
    assert gelgate("bundle", "sign", copy, "--key", tmp_path / "plant.key").code == 0
    outcome = run(copy, [pictures / "apart"], tmp_path / "out", "--no-contact", pictures / "free", "--write")
    assert outcome.code == 0, outcome.err
    assert "sign it again" in outcome.err
    assert not (copy / "manifest.sig").exists()
    after = json.loads((copy / "manifest.json").read_text())
    assert {k for k in after if after[k] != before[k]} == {"facts"}
    assert set(after) == set(before)
    assert set(after["facts"]) - set(before["facts"]) == {"detectability"}
    assert read_card(Bundle.load(copy).manifest.facts) == card(tmp_path / "out")
    assert re.search(
        r"^detectability +dent: found in 90 % of cases", gelgate("bundle", "inspect", copy).out, re.MULTILINE
    )


def test_a_card_that_is_none_is_refused(fitted: Path, tmp_path: Path) -> None:
    """`inspect` says of a damaged card what is wrong; a station, which reads none, inspects all the same. A bundle
    without one has no line of it."""
    copy = Path(shutil.copytree(fitted, tmp_path / "bundle"))
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["facts"]["detectability"] = {"presses": 0}
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert (
        "manifest.json is wrong: facts.detectability.created" in gelgate("bundle", "inspect", copy).sentence()
    )
    assert Bundle.load(copy).manifest.part
    assert "detectability" not in gelgate("bundle", "inspect", fitted).out


Sources = Callable[[Path, Bench], list[Path]]


def one_press(pictures: Path, bench: Bench) -> list[Path]:
    return [pictures / "apart" / "p08.png"]


def copies(pictures: Path, bench: Bench) -> list[Path]:
    """Copied presses of the fit would find too much: one of them is a golden frame of the bundle."""
    return [Path(shutil.copytree(pictures / "learnt", pictures / "copied", dirs_exist_ok=True))]


def other_sensor(pictures: Path, bench: Bench) -> list[Path]:
    """Exchanged colours."""
    for number in range(5):
        write(pictures / "other" / f"p{number}.png", bench.press(20 + number)[..., [1, 2, 0]])
    return [pictures / "other"]


def no_contact(pictures: Path, bench: Bench) -> list[Path]:
    """Pictures of the free gel touch nothing."""
    rng = np.random.default_rng(0)
    for number in range(5):
        noisy = bench.free().astype(int) + rng.integers(-1, 2, (240, 320, 3))
        write(pictures / "empty" / f"p{number}.png", np.clip(noisy, 0, 255).astype(np.uint8))
    return [pictures / "empty"]


def small(pictures: Path, bench: Bench) -> list[Path]:
    write(pictures / "small" / "p.png", np.full((60, 80, 3), 120, np.uint8))
    return [pictures / "small"]


@pytest.mark.parametrize(
    ("sources", "more", "sentence"),
    [
        (one_press, (), "at least 4 that it has not learnt"),
        (copies, (), "has learnt, under another name"),
        (other_sensor, (), "5 of 5 presses are of another sensor"),
        (no_contact, (), "no contact is seen"),
        (small, (), "80x60"),
        (one_press, ("--kind", "dents"), "did you mean 'dent'"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(
    sources: Sources,
    more: tuple[str, ...],
    sentence: str,
    fitted: Path,
    pictures: Path,
    bench: Bench,
    tmp_path: Path,
) -> None:
    outcome = run(fitted, sources(pictures, bench), tmp_path, "--no-contact", pictures / "free", *more)
    assert outcome.code != 0
    assert sentence in outcome.sentence()


def test_an_output_that_is_a_file_is_refused(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    outcome = run(fitted, [pictures / "apart"], tmp_path / "out")
    assert outcome.code != 0
    assert "cannot be a folder" in outcome.sentence()
