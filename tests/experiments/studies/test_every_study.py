"""`gelgate lab study all` at a reduced size: every study into one file of rows, their pages, and an answer."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from command_line import gelgate
from study_cells import quiet
from study_dataset import study_dataset

from calibration.experiments.harness.rows import read_rows
from calibration.experiments.harness.study import Options
from calibration.experiments.studies.command import study_all


def test_all_studies_continue_and_write_their_pages(tmp_path: Path) -> None:
    """Without a second position that study is left out with its sentence; a second run adds no row."""
    dataset, output = study_dataset(tmp_path / "data", positions=("pos1",)), tmp_path / "rows"
    asked = Options(
        dataset=dataset, output=output, methods=("subspace",), parts=("PZ3",), seeds=1, held_out=2, show=quiet
    )
    size: dict[str, Any] = {"presses": 2, "fractions": (1.0,), "shots": (1,), "views": ("lr", "lr_full")}
    lines = [line for _ in range(2) for line in study_all(replace(asked, **size))]
    rows = read_rows(output / "rows.jsonl")

    assert len({row["key"] for row in rows}) == len(rows)
    assert {row["study"] for row in rows} == {"good-fraction", "resolution", "bad-presses"}
    assert [line for line in lines if line.startswith("cross-position: left out: PZ3 has the one position")]
    assert (output / "report" / "good-fraction.md").is_file()
    assert (output / "report" / "resolution.md").is_file()
    assert (output / "report" / "recommend.md").is_file()
    totals = [line.partition("; ")[2] for line in lines if line.startswith("all: ")]
    assert len(totals) == 2
    assert totals[0] == totals[1]  # of all cells, also of those that the second run did not do
    assert totals[0].startswith(f"its {len(rows)} cells took ")
    assert (
        "**undecided: the rows have subspace alone, so there is nothing to compare it with"
        in gelgate("lab", "recommend", output).out
    )
