"""The page of validation 1: every number comes from the rows."""

import json
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import gelgate

from calibration.experiments.harness.figures import find_curves
from calibration.experiments.studies.good_fraction_study import page
from calibration.experiments.studies.report import write_report
from edge.core.errors import ConfigError

FRACTIONS = (0.25, 0.5, 1.0)
LEVEL = {0.25: 0.60, 0.5: 0.696, 1.0: 0.70}


def rows(**changed: Any) -> pd.DataFrame:
    """Two methods on two parts; `flat` is the same everywhere, `steep` reaches its level at one half."""
    found = []
    for part, pool in (("PZ1", 380), ("PZ3", 110)):
        for method in ("flat", "steep"):
            for fraction in FRACTIONS:
                for seed in range(4):
                    value = (0.7 if method == "flat" else LEVEL[fraction]) + 0.001 * (seed - 1.5)
                    found.append(
                        {
                            "key": f"{part}{method}{fraction}{seed}", "study": "good-fraction", "part": part,
                            "position": "pos1", "method": method, "mode": "corrected", "backbone": "tiny",
                            "split": "press", "seed": seed, "fraction": fraction, "held_out": 20,
                            "aupro_001": value, "auprc": value, "pixel_auroc": value, "image_auroc": value,
                            "presses": round(fraction * pool), "pool": pool, "cpu_fit_s": 0.5, "cpu_score_s": 0.2,
                            "cpu_measure_s": 0.1, "bank_bytes": 1000,
                        }
                        | changed
                    )  # fmt: skip
    return pd.DataFrame(found)


def squeeze(text: str) -> str:
    """Leave out the spaces that put columns in line."""
    return re.sub(" +", " ", text)


def line_of(markdown: str, start: str) -> str:
    return next(line for line in squeeze(markdown).splitlines() if line.startswith(f"| {start} |"))


def test_the_plateau_follows_its_rule() -> None:
    """`steep` at one half is within 0.01 of its level, at a quarter it is not; presses and gel are of each part,
    also of one that has no row at that fraction. A method that still rises has none."""
    some, rising = rows(), rows()
    found = page(some).text
    assert line_of(found, "flat") == "| flat | 25 % | - | PZ1 95, PZ3 28 | 10 % |"
    assert line_of(found, "steep") == "| steep | 50 % | - | PZ1 190, PZ3 55 | 19 % |"

    some.loc[some["part"] == "PZ1", ["aupro_001", "auprc", "pixel_auroc"]] = 0.7
    fewer = page(some[(some["part"] == "PZ3") | (some["fraction"] != 0.5)]).text
    assert line_of(fewer, "steep") == "| steep | 50 % | - | PZ1 190, PZ3 55 | 19 % |"

    rising["aupro_001"] += 0.1 * rising["fraction"]
    assert "| 100 % (the largest: no plateau) |" in line_of(page(rising).text, "steep")


def test_the_splits_are_compared_where_both_have_cells() -> None:
    """Means by press and by specimen. At 100 % `steep` has 0.7 by press; its lower fractions have no counterpart."""
    other = rows(split="specimen", aupro_001=0.65)
    both = squeeze(page(pd.concat([rows(), other])).text)
    largest = squeeze(page(pd.concat([rows(), other[other["fraction"] == 1.0]])).text)

    assert "| tiny | corrected | flat | PZ1 | 12 | 0.7000 | 0.6500 | +0.0500 |" in both
    assert "| tiny | corrected | steep | PZ1 | 4 | 0.7000 | 0.6500 | +0.0500 |" in largest


def test_a_curve_has_the_presses_behind_each_mean() -> None:
    """In rising order of the fraction; with all presses there is no interval."""
    found = find_curves(rows(), "fraction", "aupro_001").loc["PZ1", "flat"]

    assert found.index.tolist() == [0.25, 0.5, 1.0]
    assert found["presses"].tolist() == [95, 190, 380]
    assert found["low"].isna().tolist() == [False, False, True]
    assert find_curves(rows(), "shots", "aupro_001").empty


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there are no rows at"),
        ("", "has no complete row yet; continue the study"),
        ('{"format": 1, "key": "a", "study": "unknown"}\n', "has rows of unknown, which have no page here"),
        ('{"format": 1, "key": "a"}\n', "has rows that are of no study"),
        ("hello\n", "is not a row of results"),
    ],
)
def test_rows_that_give_no_page_are_a_sentence(tmp_path: Path, text: str | None, said: str) -> None:
    """The exit code is that of a wrong configuration. Rows of a trade-off have the same file name and no study."""
    if text is not None:
        (tmp_path / "rows.jsonl").write_text(text)
    done = gelgate("lab", "report", str(tmp_path), "-o", str(tmp_path / "out"))

    assert done.code == 3
    assert said in done.err


def test_a_report_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    """A file is in the place of the folder."""
    lines = [json.dumps({"format": 1, **row}) for row in rows().to_dict("records")]
    (tmp_path / "rows.jsonl").write_text("\n".join(lines) + "\n")
    (tmp_path / "file").write_text("")

    with pytest.raises(ConfigError, match="file cannot be a folder: File exists; choose another place"):
        write_report(tmp_path, tmp_path / "file")
