"""The table of the ideas' gains: what is compared, what is said about it, and rows that are not complete."""

import json
from pathlib import Path
from typing import Any

import pytest

from calibration.benchmark.idea_table import gains, idea_table, main, trial_table
from calibration.benchmark.ideas import BASE, IDEAS, NOT_TRAINED, PHOTOGRAPH, PHOTOGRAPH_OF_IT

COMPARED = (PHOTOGRAPH, PHOTOGRAPH_OF_IT, NOT_TRAINED)


def row(idea: str, seed: int, alone: float, joined: float) -> dict[str, Any]:
    chance = 0.0004 * (seed - 0.5) * (idea in IDEAS and idea != BASE)

    def found(real: float) -> dict[str, dict[str, float]]:
        ball = {"padim": real - 0.1 + chance, "patchcore": real + 0.1 + chance}
        return {"ball": ball, "RP0": {"padim": 0.7 + 0.01 * seed + chance}}

    return {
        "idea": idea,
        "seed": seed,
        "real": ["ball"],
        "aupro_fpr01": found(alone),
        "joined_aupro_fpr01": found(joined),
    }


def rows(gain: dict[str, float] | None = None) -> list[dict[str, Any]]:
    """Four seeds of the base, .40 to .43 alone and .60 to .63 joined; two of each idea, which gain joined alone."""
    more = gain or {}
    return [
        *(row(name, 0, 0.1, 0.5) for name in COMPARED),
        *(row(BASE, seed, 0.4 + 0.01 * seed, 0.6 + 0.01 * seed) for seed in range(4)),
        *(
            row(
                name, seed, 0.4 + 0.01 * seed, 0.6 + 0.01 * seed + more.get(name, 0.0) + 0.0004 * (seed - 0.5)
            )
            for name in IDEAS
            if name != BASE
            for seed in range(2)
        ),
    ]


def test_a_gain_is_what_an_idea_adds_to_the_base_of_its_seeds() -> None:
    """.05 joined and nothing alone, whatever a seed gives."""
    found = rows({"distilled": 0.05})

    assert gains(found, "joined_aupro_fpr01", is_real=True)["distilled"].value == pytest.approx(
        0.05, abs=1e-3
    )
    assert gains(found, "aupro_fpr01", is_real=True)["distilled"].value == pytest.approx(0, abs=1e-9)
    assert list(gains(found, "aupro_fpr01", is_real=False)) == [name for name in IDEAS if name != BASE]


def test_the_table_says_where_an_idea_pays_and_where_it_harms() -> None:
    """By reading, with its seeds and noise; what is within the noise is not decided."""
    lines = idea_table(rows({"distilled": 0.05, "other dots": -0.04})).splitlines()

    (pays,) = [line for line in lines if line.startswith("| distilled |")]
    (harms,) = [line for line in lines if line.startswith("| other dots |")]
    (nothing,) = [line for line in lines if line.startswith("| other units |")]
    assert "| 2 | +0.000 ± 0.000 | +0.050 ± 0.00" in pays
    assert pays.endswith("| pays: real presses joined |")
    assert harms.endswith("| harms: real presses joined |")
    assert nothing.endswith("| not decided |")


def test_below_are_the_means_of_what_is_compared_with() -> None:
    """The base over its four seeds, and the networks without tactile channels or without training."""
    lines = idea_table(rows()).splitlines()

    assert any(line.startswith(f"| {BASE} |") and "| 0.415 | 0.615 | 0.715 |" in line for line in lines)
    for name in COMPARED:
        assert any(line.startswith(f"| {name} |") and "| 0.100 | 0.500 | 0.700 |" in line for line in lines)


def test_every_joined_trunk_has_its_trials() -> None:
    """Means over the seeds, by trial and method; alone they are others."""
    lines = trial_table(rows(), is_joined=True).splitlines()

    assert lines[0] == "| joined | ball, padim | ball, patchcore | RP0, padim |"
    assert [line.split(" | ")[0][2:] for line in lines[2:]] == [*COMPARED, *IDEAS]
    (base,) = [line for line in lines if line.startswith(f"| {BASE} |")]
    assert base == f"| {BASE} | 0.515 | 0.715 | 0.715 |"
    assert f"| {BASE} | 0.315 | 0.515 | 0.715 |" in trial_table(rows(), is_joined=False).splitlines()


@pytest.mark.parametrize(
    ("kept", "sentence"),
    [
        (lambda row: row["idea"] != "distilled", "the rows lack distilled; continue the run"),
        (lambda row: row["idea"] != PHOTOGRAPH, f"the rows lack {PHOTOGRAPH}; continue the run"),
        (lambda row: row["idea"] != BASE or row["seed"] < 2, "2 of them of the base, too few to know"),
        (lambda row: row["idea"] == BASE or row["seed"] < 1, "4 of them of the base, too few to know"),
    ],
)
def test_incomplete_rows_are_refused(
    kept: Any, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence says what is missing."""
    file = tmp_path / "ideas.jsonl"
    file.write_text("".join(json.dumps(one) + "\n" for one in rows() if kept(one)))

    assert main([str(file)]) == 3
    assert sentence in capsys.readouterr().err


def test_the_command_prints_every_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And names a file that holds no rows."""
    file = tmp_path / "ideas.jsonl"
    file.write_text("".join(json.dumps(one) + "\n" for one in rows()))

    assert main([str(file)]) == 0
    by_trial = [trial_table(rows(), is_joined=is_joined) for is_joined in (False, True)]
    assert capsys.readouterr().out == "\n".join([idea_table(rows()), *by_trial])
    assert main([str(tmp_path / "none.jsonl")]) == 3
    assert "none.jsonl' holds no rows; write them with" in capsys.readouterr().err
    assert main([]) == 2
