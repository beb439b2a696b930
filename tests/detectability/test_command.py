"""`gelgate lab detectability`: the smallest damage found, from pictures to the card in the bundle."""

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import Outcome, gelgate
from pressed_dome import Bench, write

from edge.model.bundle import Bundle
from edge.model.detectability import DetectabilityCard

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
    assert "dent" in (output / "detectability.txt").read_text()


def test_learnt_presses_are_judged_by_banks_without_them(
    fitted: Path, pictures: Path, tmp_path: Path
) -> None:
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


def test_trials_of_another_bundle_are_not_taken(measured: tuple[Path, Outcome], fitted: Path) -> None:
    """A row's key depends on the bundle: it is in no other bundle's results."""
    keys = {json.loads(line)["key"] for line in trials(measured[0])}
    assert len(keys) == 16
    assert Bundle.load(fitted).digest not in keys


def test_the_card_is_written_and_printed(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """The bundle keeps every file and field; only its facts gain the card, which `inspect` prints and `load` checks."""
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
    assert Bundle.load(copy).manifest.detectability == card(tmp_path / "out")
    assert re.search(
        r"^detectability +dent: found in 90 % of cases", gelgate("bundle", "inspect", copy).out, re.MULTILINE
    )


def test_a_card_that_is_none_is_refused(fitted: Path, tmp_path: Path) -> None:
    """A damaged card makes the bundle corrupt, with a sentence."""
    copy = Path(shutil.copytree(fitted, tmp_path / "bundle"))
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["facts"]["detectability"] = {"presses": 0}
    (copy / "manifest.json").write_text(json.dumps(manifest))
    refused = gelgate("bundle", "inspect", copy)
    assert refused.code != 0
    assert "manifest.json is wrong" in refused.sentence()


def test_a_bundle_without_a_card_has_no_line_of_it(fitted: Path) -> None:
    """Nothing is said of what was not measured."""
    assert "detectability" not in gelgate("bundle", "inspect", fitted).out


def refused(outcome: Outcome) -> str:
    assert outcome.code != 0
    return outcome.sentence()


def test_one_press_is_too_few(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """The sentence says how many are needed."""
    one = pictures / "apart" / "p08.png"
    assert "at least 4 that it has not learnt" in refused(
        run(fitted, [one], tmp_path, "--no-contact", pictures / "free")
    )


def test_learnt_presses_under_another_name_are_noticed(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """Copied presses of the fit would find too much: one of them is a golden frame of the bundle."""
    shutil.copytree(pictures / "learnt", tmp_path / "copied")
    sentence = refused(
        run(fitted, [tmp_path / "copied"], tmp_path / "out", "--no-contact", pictures / "free")
    )
    assert "has learnt, under another name" in sentence


def test_presses_of_another_sensor_are_refused(
    fitted: Path, pictures: Path, tmp_path: Path, bench: Bench
) -> None:
    """Exchanged colours are another sensor."""
    for number in range(5):
        write(tmp_path / "other" / f"p{number}.png", bench.press(20 + number)[..., [1, 2, 0]])
    sentence = refused(run(fitted, [tmp_path / "other"], tmp_path / "out", "--no-contact", pictures / "free"))
    assert "5 of 5 presses are of another sensor" in sentence


def test_presses_without_contact_are_refused(
    fitted: Path, pictures: Path, tmp_path: Path, bench: Bench
) -> None:
    """Pictures of the free gel touch nothing."""
    rng = np.random.default_rng(0)
    for number in range(5):
        noisy = bench.free().astype(int) + rng.integers(-1, 2, (240, 320, 3))
        write(tmp_path / "empty" / f"p{number}.png", np.clip(noisy, 0, 255).astype(np.uint8))
    sentence = refused(run(fitted, [tmp_path / "empty"], tmp_path / "out", "--no-contact", pictures / "free"))
    assert "no contact is seen" in sentence


def test_pictures_of_another_size_are_refused(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    """Frames that do not fit the bundle's profile, by name and size."""
    write(tmp_path / "small" / "p.png", np.full((60, 80, 3), 120, np.uint8))
    sentence = refused(run(fitted, [tmp_path / "small"], tmp_path / "out", "--no-contact", pictures / "free"))
    assert "80x60" in sentence


def test_an_unknown_kind_names_the_nearest(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    outcome = gelgate("lab", "detectability", fitted, pictures / "apart", "-o", tmp_path, "--kind", "dents")
    assert "did you mean 'dent'" in refused(outcome)


def test_an_output_that_is_a_file_is_refused(fitted: Path, pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    assert "cannot be a folder" in refused(run(fitted, [pictures / "apart"], tmp_path / "out"))
