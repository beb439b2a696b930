"""The table of the effects' worth: the noise by hand, the rule, and what is said about rows that are not complete."""

import json
from pathlib import Path
from typing import Any

import pytest

from calibration.benchmark import effect_table
from calibration.benchmark.effect_ablation import ALL, NOT_TRAINED, ROWS, VARIANTS, measure_costs
from calibration.benchmark.effect_table import leaving, main, worths
from calibration.benchmark.seed_differences import Worth
from calibration.benchmark.short_trunks import rows_of
from calibration.simulator.effects import EFFECTS
from calibration.studies.intervals import t_quantile

COSTS = {"press_ms": 10.0, "costs_ms": dict.fromkeys(EFFECTS, 0.5)}


def row(name: str, seed: int, real: float) -> dict[str, Any]:
    return {
        "without": name,
        "seed": seed,
        "real": ["ball"],
        "aupro_fpr01": {
            "ball": {"padim": real - 0.1, "patchcore": real + 0.1},
            "RP0": {"padim": 0.7 + 0.01 * (seed % 2)},
        },
    }


def rows(worth: dict[str, float] | None = None) -> list[dict[str, Any]]:
    """Three seeds with every effect, .50, .52 and .54 on real presses, and one without each."""
    lost = worth or {}
    return [
        COSTS,
        row(NOT_TRAINED, 0, 0.1),
        *(row(ALL, seed, 0.5 + 0.02 * seed) for seed in range(3)),
        *(row(name, 0, 0.5 - lost.get(name, 0.0)) for name in VARIANTS if name != ALL),
    ]


def test_the_noise_is_what_effect_and_seed_do_not_explain() -> None:
    """Without grain .02 are lost with one seed and .06 with the other: .04 ± t(1) times half of what they differ by."""
    found = worths([*rows({"grain": 0.02}), row("grain", 1, 0.46)], is_real=True)

    assert found["grain"].value == pytest.approx(0.04)
    assert found["grain"].noise == pytest.approx(t_quantile(1) * 0.02)
    assert found["dust"].noise > found["grain"].noise


def test_what_the_seed_gives_is_no_noise() -> None:
    """The second seed is better by .02 with grain and without: a worth of .03 is exact."""
    found = worths([*rows({"grain": 0.03}), row("grain", 1, 0.49)], is_real=True)

    assert found["grain"].value == pytest.approx(0.03)
    assert found["grain"].noise == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("value", "noise", "shown"),
    [(0.03, 0.02, "pays"), (0.03, 0.04, ""), (-0.01, 0.02, "is_small"), (-0.03, 0.02, "harms is_small")],
)
def test_a_worth_pays_or_harms_or_is_small_or_not_decided(value: float, noise: float, shown: str) -> None:
    """It pays when its interval is above 0, harms when it is below, and is small when it ends below .02."""
    found = Worth(value, noise)

    assert [name for name in ("pays", "harms", "is_small") if getattr(found, name)] == shown.split()


def narrow(worth: dict[str, float]) -> list[dict[str, Any]]:
    """Two seeds of everything, which differ by .001 at most."""
    second = [row(name, 1, 0.52 - worth.get(name, 0.0) + 0.0005) for name in VARIANTS if name != ALL]
    return [*rows(worth), *second]


def test_what_is_shown_to_be_worth_little_leaves_the_default_list(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four effects without worth one is kept, one is cheap, one pays on simulated parts, and one leaves."""
    monkeypatch.setattr(effect_table, "KEPT", {"noise": "limits"})
    cheap = COSTS | {"costs_ms": COSTS["costs_ms"] | {"jpeg": 0.09}}
    found = [cheap, *narrow({})[1:]]
    for one in found:
        if one.get("without") == "specular":
            one["aupro_fpr01"]["RP0"]["padim"] -= 0.3

    assert leaving(found, ["specular", "noise", "jpeg", "shadows"]) == ["shadows"]
    assert leaving(found, []) == []


def test_what_is_not_decided_stays() -> None:
    """With one noisy pair of seeds no worth is shown to be below .02."""
    assert leaving([*rows(), row("grain", 1, 0.46)], ["shadows"]) == []


def test_the_table_has_every_effect_with_its_cost_and_result() -> None:
    """Seeds, worth and noise on both, and the result in words; at its end the effects that are never left out."""
    lines = effect_table.effect_table(narrow({"lens_blur": 0.3, "dust": -0.2, "grain": -0.2})).splitlines()

    never_left_out = ["illumination", "vignette", "motion_blur"]
    scale = lines.index("")
    assert scale == 2 + len(VARIANTS) - 1 + len(never_left_out)
    assert [line.split("`")[1] for line in lines[scale - 3 : scale]] == never_left_out
    assert (
        lines[-1] == "With random weights the mean is 0.100 on real presses and 0.700 on the simulated part."
    )
    (blur,) = [line for line in lines if line.startswith("| `lens_blur`")]
    assert blur.startswith("| `lens_blur` | 0.5 | 5% | 2 | +0.300 ± 0.0")
    assert blur.endswith("| pays on real presses |")
    (dust,) = [line for line in lines if line.startswith("| `dust`")]
    assert dust.endswith("| harms on real presses; kept: the life of a gel |")
    (grain,) = [line for line in lines if line.startswith("| `grain`")]
    assert grain.endswith("| harms on real presses; leaves the default list |")


@pytest.mark.parametrize(
    ("kept", "sentence"),
    [
        (lambda row: row.get("without") != "dust", "the rows lack dust; continue the run"),
        (lambda row: row.get("without") != NOT_TRAINED, "the rows lack random weights; continue the run"),
        (lambda row: row.get("seed") != 1, "the rows hold 17 trunks, 2 of them with every effect, too few"),
        (lambda row: row.get("seed") != 2, "the rows hold 32 trunks, 2 of them with every effect, too few"),
        (
            lambda row: row.get("without") == ALL or row.get("seed") != 1,
            "the rows hold 18 trunks, 3 of them with every effect, too few",
        ),
        (lambda row: "costs_ms" not in row, "the rows hold no costs; continue the run"),
    ],
)
def test_incomplete_rows_are_refused(
    kept: Any, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence says what is missing."""
    file = tmp_path / "effects.jsonl"
    file.write_text("".join(json.dumps(one) + "\n" for one in narrow({}) if kept(one)))

    assert main([str(file)]) == 3
    assert sentence in capsys.readouterr().err


def test_a_file_without_rows_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No file, a damaged one, and no argument at all."""
    assert main([str(tmp_path / "none.jsonl")]) == 3
    assert "none.jsonl' holds no rows; write them with" in capsys.readouterr().err
    (tmp_path / "bad.jsonl").write_text("{\n")
    assert main([str(tmp_path / "bad.jsonl")]) == 3
    assert "bad.jsonl' is damaged" in capsys.readouterr().err
    assert main([]) == 2
    assert "name one file of rows" in capsys.readouterr().err


def test_the_mean_is_over_trials_of_the_mean_over_methods() -> None:
    """A trial that one method reads counts as much as one that two read."""
    found = narrow({})
    for one in found:
        if one.get("without") == "grain":
            one["aupro_fpr01"]["finger"] = {"patchcore": one["aupro_fpr01"]["ball"]["padim"] - 0.1}
            one["real"] = ["ball", "finger"]

    # The ball is .5 on the average of its methods, the finger .3, and every other variant .5.
    plain, more = (worths(of, is_real=True)["grain"].value for of in (narrow({}), found))
    assert more - plain == pytest.approx(0.1)


def test_every_effect_s_cost_is_measured_once(tmp_path: Path) -> None:
    """The first call adds a row with all effects, the second adds none."""
    measure_costs(tmp_path, rounds=1)
    measure_costs(tmp_path, rounds=1)

    (row,) = rows_of(tmp_path / ROWS)
    assert list(row["costs_ms"]) == list(EFFECTS)
    assert row["press_ms"] > 0
