"""The page of validation 1: every number comes from the rows."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import gelgate

from calibration.experiments.harness.figures import curves, gel_share, svg
from calibration.experiments.studies.good_fraction_study import page, same_in_every_seed
from calibration.experiments.studies.report import write_report
from edge.core.errors import ConfigError, StoreError

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
                            "scores_sha256": "same" if method == "flat" and fraction == 1.0 else f"{seed}",
                        }
                        | changed
                    )  # fmt: skip
    return pd.DataFrame(found)


def line_of(markdown: str, start: str) -> str:
    return next(line for line in markdown.splitlines() if line.startswith(f"| {start} |"))


def test_the_plateau_follows_its_rule() -> None:
    """`steep` at one half is within 0.01 of its level, at a quarter it is not; presses and gel are of each part."""
    found = page(rows()).markdown

    assert line_of(found, "flat") == "| flat | 25 % | - | PZ1 95, PZ3 28 | 10 % |"
    assert line_of(found, "steep") == "| steep | 50 % | - | PZ1 190, PZ3 55 | 19 % |"
    assert "is within 0.01 of that of the largest fraction" in found


def test_the_plateau_counts_the_presses_of_every_part() -> None:
    """Also of a part that has no row at that fraction: its half of 380 presses is the most of a gel's life."""
    some = rows()
    some.loc[some["part"] == "PZ1", ["aupro_001", "auprc", "pixel_auroc"]] = 0.7
    found = page(some[(some["part"] == "PZ3") | (some["fraction"] != 0.5)]).markdown

    assert line_of(found, "steep") == "| steep | 50 % | - | PZ1 190, PZ3 55 | 19 % |"


def test_a_method_that_still_rises_has_no_plateau() -> None:
    """It is called so."""
    rising = rows()
    rising["aupro_001"] += 0.1 * rising["fraction"]

    assert "| 100 % (the largest: no plateau) |" in line_of(page(rising).markdown, "steep")


def test_means_have_intervals() -> None:
    """Of four seeds 0.001 apart, around their mean; with all presses there is none, because all learn the same."""
    line = "| PZ1 | flat | 380 | 0.700 [0.698, 0.702] | 0.700 [0.698, 0.702] | 0.700 |"
    assert line in page(rows()).markdown


def test_seeds_that_are_one_computation_are_named() -> None:
    """`flat` with all presses gives the same scores in every seed: its lack of scatter is no robustness."""
    found = page(rows()).markdown

    assert "**One computation, not several.**" in found
    assert "| flat | PZ1, PZ3 | 100 % | 4 |" in found
    assert set(same_in_every_seed(rows())["method"]) == {"flat"}


def test_changed_settings_are_named() -> None:
    """A method that could not be run as published says what it reads."""
    found = page(rows(changed="taps layer1; grid_tap layer1")).markdown

    assert "flat runs with taps layer1; grid_tap layer1, because the backbone lacks" in found


def test_one_seed_is_not_called_a_repetition() -> None:
    """There is nothing to compare it with."""
    assert "One computation" not in page(rows()[lambda r: r["seed"] == 0]).markdown


def test_the_difference_of_the_splits_is_shown() -> None:
    """Means by press and by specimen, and how much the first is higher."""
    both = pd.concat([rows(), rows(split="specimen", aupro_001=0.65)])
    found = page(both).markdown

    assert "split by press" in found
    assert "split by specimen" in found
    assert "| tiny | corrected | flat | PZ1 | 12 | 0.7000 | 0.6500 | +0.0500 |" in found


def test_the_splits_are_compared_where_both_have_cells() -> None:
    """At 100 % `steep` has 0.7 by press; its lower fractions have no counterpart and do not count."""
    other = rows(split="specimen", aupro_001=0.65)
    found = page(pd.concat([rows(), other[other["fraction"] == 1.0]])).markdown

    assert "| tiny | corrected | steep | PZ1 | 4 | 0.7000 | 0.6500 | +0.0500 |" in found


def test_the_cells_say_how_many_seeds_the_conditions_have() -> None:
    """Four seeds everywhere, or one at some fractions."""
    some = rows()
    found = page(some[(some["fraction"] == 1.0) | (some["seed"] == 0)]).markdown

    assert "| flat, steep | 0.25, 0.5, 1 | 4 | 24 |" in page(some).markdown
    assert "| flat, steep | 0.25, 0.5, 1 | 1 to 4 | 12 |" in found


def test_refused_cells_are_counted_with_their_reason() -> None:
    """They are not in any mean."""
    some = rows()
    some["error"] = pd.Series([None] * len(some), dtype=object)
    some.loc[0, ["error", "aupro_001", "auprc", "pixel_auroc", "presses", "scores_sha256"]] = [
        "too few",
        *[None] * 5,
    ]
    found = page(some).markdown

    assert "| flat | corrected | tiny | 1 | too few |" in found


def test_few_presses_have_a_table_and_a_figure_of_their_own() -> None:
    """The field's curve, by the number of presses."""
    shots = rows().rename(columns={"fraction": "shots"})
    shots["shots"] = (8 * shots["shots"]).astype(int)
    found = page(shots)

    assert "| part | method | 2 | 4 | 8 |" in found.markdown
    assert list(found.figures) == ["good-fraction-corrected-tiny-press-shots.svg"]


def test_the_page_is_the_same_in_every_run() -> None:
    """Figures too: no date, no identifier of a process; and each is named on the page."""
    first, second = page(rows()), page(rows())

    assert first.markdown == second.markdown
    assert all(f"]({name})" in first.markdown for name in first.figures)
    drawn = {name: svg(draw()) for name, draw in first.figures.items()}
    assert drawn == {name: svg(draw()) for name, draw in second.figures.items()}
    assert not any(re.search(r"<dc:date>|20\d\d-\d\d-\d\dT", text) for text in drawn.values())


def test_a_full_study_has_small_figures() -> None:
    """Five parts, four methods, twenty fractions, ten seeds: below 300 kB each."""
    rng = np.random.default_rng(0)
    every = pd.concat(
        [
            rows(part=f"PZ{part}", method=method, fraction=k / 20, seed=seed).iloc[:1]
            for part in range(5)
            for method in "abcd"
            for k in range(1, 21)
            for seed in range(10)
        ]
    )
    every["aupro_001"] = rng.uniform(0.5, 1, len(every))
    sizes = [len(svg(draw())) for draw in page(every).figures.values()]

    assert len(sizes) == 3 + 5
    assert max(sizes) < 300_000


def test_a_curve_has_every_seed() -> None:
    """In rising order of the fraction, with the presses behind each."""
    found = next(curves(rows(), "fraction", "aupro_001"))

    assert (found.part, found.method) == ("PZ1", "flat")
    assert found.x.tolist() == [0.25, 0.5, 1.0]
    assert found.presses.tolist() == [95, 190, 380]
    assert [len(values) for values in found.values] == [4, 4, 4]
    assert list(curves(rows(), "shots", "aupro_001")) == []


def test_gel_is_in_parts_of_its_rated_life() -> None:
    """A gel is rated for 1000 presses."""
    assert gel_share(110) == pytest.approx(0.11)


def test_a_report_is_written_from_a_folder_of_rows(tmp_path: Path) -> None:
    """The page and its figures, in a new folder."""
    lines = [json.dumps({"format": 1, **row}) for row in rows().to_dict("records")]
    (tmp_path / "rows.jsonl").write_text("\n".join(lines) + "\n")
    written, *_, advice, time = write_report(tmp_path, tmp_path / "out" / "report")

    assert (written.name, advice.name, time.name) == ("good-fraction.md", "recommend.md", "time.md")
    assert len(list(written.parent.glob("*.svg"))) == 5


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


def test_a_line_that_was_cut_is_said(tmp_path: Path) -> None:
    """The report leaves it out, and is of the other rows."""
    lines = [json.dumps({"format": 1, **row}) for row in rows().to_dict("records")]
    (tmp_path / "rows.jsonl").write_text("\n".join(lines))
    done = gelgate("lab", "report", str(tmp_path), "-o", str(tmp_path / "out"))

    assert done.code == 0
    assert "rows.jsonl' is incomplete, because a run was interrupted" in done.err


def test_a_report_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    """A file is in the place of the folder."""
    lines = [json.dumps({"format": 1, **row}) for row in rows().to_dict("records")]
    (tmp_path / "rows.jsonl").write_text("\n".join(lines) + "\n")
    (tmp_path / "file").write_text("")

    with pytest.raises(StoreError, match="the report cannot be written"):
        write_report(tmp_path, tmp_path / "file")
    with pytest.raises(ConfigError, match="there are no rows"):
        write_report(tmp_path / "nowhere", tmp_path)


def test_the_time_of_a_complete_part_is_that_of_its_cells() -> None:
    """Two methods with 0.8 s a cell: 20 fractions and 10 seeds of each are 320 s."""
    found = page(rows()).markdown

    assert "| PZ1 | tiny | corrected | press | 380 | 2 | 5 | 3 |" in found


def test_the_page_says_which_cells_it_has() -> None:
    """Methods, fractions and seeds of each part."""
    found = page(rows()).markdown

    assert "| PZ3 | tiny | corrected | press | flat, steep | 0.25, 0.5, 1 | 4 | 24 |" in found
