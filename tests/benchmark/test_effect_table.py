"""The table of the effects' worth: the noise by hand, the rule, and what is said about rows that are not complete."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from calibration.benchmark import effect_table
from calibration.benchmark.effect_ablation import ALL, NOT_TRAINED, ROWS, VARIANTS, measure_costs, rows_of
from calibration.benchmark.effect_table import leaving, main, measured
from calibration.simulator.effects import EFFECTS
from calibration.studies.intervals import t_quantile
from edge.core.errors import ConfigError

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
    """Three seeds with every effect, .48, .50 and .52 on real presses, and one without each."""
    lost = worth or {}
    return [
        COSTS,
        row(NOT_TRAINED, 0, 0.1),
        *(row(ALL, seed, 0.48 + 0.02 * seed) for seed in range(3)),
        *(row(name, 0, 0.5 - lost.get(name, 0.0)) for name in VARIANTS if name != ALL),
    ]


def test_the_noise_is_that_of_the_seeds() -> None:
    """Values .48, .50 and .52 deviate by .02 with two degrees of freedom; three are compared with one."""
    found = measured(rows({"grain": 0.03}), is_real=True)

    assert found.worth("grain") == pytest.approx(0.03)
    assert found.noise("grain") == pytest.approx(t_quantile(2) * 0.02 * math.sqrt(1 / 3 + 1))


def test_a_further_seed_of_one_effect_narrows_its_noise() -> None:
    """Two trunks without it, .47 and .49: the pooled deviation is that of five values about two means."""
    found = measured([*rows({"grain": 0.03}), row("grain", 1, 0.49)], is_real=True)

    deviation = math.sqrt((2 * 0.02**2 + 2 * 0.01**2) / 3)
    assert found.noise("grain") == pytest.approx(t_quantile(3) * deviation * math.sqrt(1 / 3 + 1 / 2))
    assert found.noise("dust") > found.noise("grain")


def test_what_neither_pays_nor_is_needed_leaves_the_default_list(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of five effects: one pays on real presses, one on simulated parts, one is kept, one is cheap, one leaves."""
    monkeypatch.setattr(effect_table, "KEPT", {"noise": "limits"})
    cheap = COSTS | {"costs_ms": COSTS["costs_ms"] | {"jpeg": 0.09}}
    found = [cheap, *rows({"grain": 0.2})[1:]]
    shown = [
        one | {"aupro_fpr01": one["aupro_fpr01"] | {"RP0": {"padim": 0.4}}}
        if one.get("without") == "specular"
        else one
        for one in found
    ]

    assert leaving(shown, ["grain", "specular", "noise", "jpeg", "shadows"]) == ["shadows"]


def test_the_table_has_every_variant_with_its_cost_and_result() -> None:
    """Worth and noise of each, random weights for scale, and the result in words."""
    lines = effect_table.effect_table(rows({"lens_blur": 0.3})).splitlines()

    assert len(lines) == 2 + 1 + len(VARIANTS)
    (blur,) = [line for line in lines if line.startswith("| `lens_blur`")]
    assert (
        blur
        == "| `lens_blur` | 0.5 | 5% | 1 | 0.200 | +0.300 ± 0.099 | 0.700 | +0.003 ± 0.029 | pays on real presses |"
    )
    assert "| random weights |  |  | 1 | 0.100 |  | 0.700 |  |  |" in lines


@pytest.mark.parametrize(
    ("kept", "sentence"),
    [
        (lambda row: row.get("without") != "dust", "the rows lack dust; continue the run"),
        (lambda row: row.get("seed") != 2, "the rows hold 2 seeds with every effect, at least 3 are needed"),
        (lambda row: "costs_ms" not in row, "the rows hold no costs; continue the run"),
    ],
)
def test_incomplete_rows_are_refused(
    kept: Any, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence says what is missing."""
    file = tmp_path / "effects.jsonl"
    file.write_text("".join(json.dumps(one) + "\n" for one in rows() if kept(one)))

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
    found = rows()
    found[2]["aupro_fpr01"]["finger"] = {"patchcore": 0.9}
    found[2]["real"] = ["ball", "finger"]

    assert measured(found, is_real=True).values[ALL][0] == pytest.approx((0.48 + 0.9) / 2)


def test_a_variant_without_a_row_is_named() -> None:
    """Of two, both."""
    with pytest.raises(ConfigError, match="the rows lack grain, jpeg"):
        measured([one for one in rows() if one.get("without") not in ("grain", "jpeg")], is_real=True)


def test_every_effect_s_cost_is_measured_once(tmp_path: Path) -> None:
    """The first call adds a row with all effects, the second adds none."""
    measure_costs(tmp_path, rounds=1)
    measure_costs(tmp_path, rounds=1)

    (row,) = rows_of(tmp_path / ROWS)
    assert list(row["costs_ms"]) == list(EFFECTS)
    assert row["press_ms"] > 0
