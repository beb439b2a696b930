"""The evaluation: learnt presses are not scored, simple cases have known numbers, and errors are one sentence."""

import json
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.experiments.backbones import command as evaluate_command
from calibration.experiments.backbones.evaluation import evaluate, random_trunk
from calibration.experiments.backbones.sets import EvaluationSet, Sizes, Trial, part_trial
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import open_trunk
from edge.cli import build
from edge.core.errors import ConfigError

FEW = Sizes(pieces=3, held_out=1, presses=1, damaged=1, free_gels=1)


def trial(name: str, seed: int) -> Trial:
    """Sixteen noisy grey presses to learn; four more, and four with a black square."""
    rng = np.random.default_rng(seed)

    def grey(n: int) -> np.ndarray:
        return rng.integers(110, 140, (n, 64, 64, 3), dtype=np.uint8)

    scored, masks = grey(8), np.zeros((8, 64, 64), np.bool_)
    masks[4:, 24:40, 24:40] = True
    scored[masks] = 0
    nominal = NominalPresses(grey(16), tuple(map(str, range(16))))
    return Trial(name, nominal, scored, masks)


SQUARES = EvaluationSet("Squares", "Black squares.", (partial(trial, "a", 0), partial(trial, "b", 1)))


def test_a_black_square_is_found() -> None:
    """Two trials of an obvious defect: image AUROC 1, intervals around the mean of both."""
    found = evaluate({"random": random_trunk()}, {"squares": SQUARES}, ("padim",), replicates=20)
    written = found["sets"]["squares"]
    (row,) = written["rows"]
    assert written["trials"] == ["a", "b"]
    assert (row["backbone"], row["detector"]) == ("random", "padim")
    assert row["measures"]["image_auroc"] == {"value": 1.0, "over_images": [1.0, 1.0]}
    pixel = row["measures"]["pixel_auroc"]
    assert 0.8 < pixel["over_images"][0] <= pixel["value"] <= pixel["over_images"][1] <= 1
    each = [row["trials"][name]["pixel_auroc"] for name in ("a", "b")]
    assert np.isclose(np.mean(each), pixel["value"], atol=1e-4)


def test_trials_spread_over_processes_measure_the_same() -> None:
    """Two workers give the same numbers as one."""
    sets = {"pieces": EvaluationSet("Pieces", "Two.", (partial(part_trial, "PZ3", "plain", FEW),) * 2)}
    trunks = {"trained": open_trunk("tactile_resnet18").graph}
    alone = evaluate(trunks, sets, ("padim",), replicates=0)
    together = evaluate(trunks, sets, ("padim",), replicates=0, workers=2)
    one, other = (found["sets"]["pieces"]["rows"][0]["trials"] for found in (alone, together))
    assert one.keys() == other.keys()
    for name in one:
        assert one[name] == pytest.approx(other[name], abs=1e-4)


CONDITIONS = ("plain", "unseen sensor", "worn gel", "marker gel", "residual imprint", "sliding press")


@cache
def simulated(condition: str) -> Trial:
    return part_trial("PZ5", condition, FEW)


@pytest.mark.parametrize("condition", CONDITIONS)
def test_simulated_trials_hold_pieces_out(condition: str) -> None:
    """No learnt piece is scored, damaged presses come first and have masks, and the free gel is known."""
    found = simulated(condition)
    assert found.nominal.specimens == ("001", "002")
    assert found.frames.shape == (2, 224, 224, 3)
    assert [bool(m.any()) for m in found.masks] == [True, False]
    assert found.nominal.touched is not None
    assert found.nominal.touched.any()
    assert found.nominal.no_contact is not None


def test_conditions_differ_where_they_say() -> None:
    """The unseen sensor has other colours, the marker gel dark dots, a worn gel differs when scored, and a residual
    imprint shows on a small part. A sliding press is smeared among the scored presses and not among the learnt ones.
    """
    plain, sensor, worn, marker, remembering, sliding = map(simulated, CONDITIONS)

    def free(of: Trial) -> np.ndarray:
        assert of.nominal.no_contact is not None
        return of.nominal.no_contact.astype(float)

    assert np.abs(free(sensor).mean(axis=(0, 1, 2)) - free(plain).mean(axis=(0, 1, 2))).max() > 5
    assert free(marker).min() < 0.5 * free(plain).min()
    apart = np.abs(worn.frames.astype(float) - plain.frames)
    assert (apart.max(axis=3) > 10).mean() > 0.001
    left = np.abs(remembering.frames.astype(float) - plain.frames)
    assert 0 < (left.max(axis=3) > 4).mean() < 0.1
    assert np.array_equal(sliding.nominal.frames, plain.nominal.frames)
    assert (np.abs(sliding.frames.astype(float) - plain.frames).max(axis=3) > 4).mean() > 0.01


def test_the_command_writes_and_prints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One file with every number; tables on the standard output."""
    monkeypatch.setattr(evaluate_command, "_choose_sets", lambda *given: {"squares": SQUARES})
    words = ["lab", "evaluate-backbone", str(tmp_path), "trained=tactile_resnet18", "--replicates", "0"]
    done = CliRunner().invoke(build(), [*words, "--method", "padim"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "| trained  | padim    |" in done.stdout
    written = json.loads((tmp_path / "tactile_resnet18_evaluation.json").read_text())
    assert list(written["trunks"]) == ["trained", "random"]
    assert written["sets"]["squares"]["trials"] == ["a", "b"]


def test_refusals_are_sentences(tmp_path: Path) -> None:
    """An unknown backbone or set, a name twice: refused before anything is computed or written."""
    for words, sentence in (
        (["resnet_of_nowhere"], "no backbone is named 'resnet_of_nowhere'"),
        (["a=tactile_resnet18", "a=tactile_resnet18_int8"], "found twice a"),
        (["--method", "padam", "--no-random"], "no detectors plugin is named 'padam'"),
        (["--set", "part"], "no set of trials is named 'part'; did you mean 'parts'"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            CliRunner().invoke(
                build(), ["lab", "evaluate-backbone", str(tmp_path / "out"), *words], catch_exceptions=False
            )
    assert not (tmp_path / "out").exists()
