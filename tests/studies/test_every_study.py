"""`gelgate study all` at a reduced size: three studies into one file of rows, their pages, and an answer from them."""

from pathlib import Path

import pytest
from command_line import gelgate
from study_cells import quiet
from study_dataset import study_dataset

from calibration.studies import every_study
from calibration.studies.rows import read_rows
from calibration.studies.study import Options


@pytest.mark.slow
def test_all_studies_continue_and_write_their_pages(tmp_path: Path) -> None:
    """Without a second position that study is left out with its sentence; a second run adds no row."""
    dataset, output = study_dataset(tmp_path / "data", positions=("pos1",)), tmp_path / "rows"
    asked = Options(
        dataset=dataset, output=output, methods=("subspace",), modes=("paper",), seeds=1, held_out=2, show=quiet
    )
    for view in ("lr", "hr_tiled"):
        assert view in every_study.VIEWS
    lines = [line for _ in range(2) for line in every_study.study_all(asked, 2, fractions=(1.0,), shots=(1,))]
    rows = read_rows(output / "rows.jsonl")

    assert len({row["key"] for row in rows}) == len(rows)
    assert {row["study"] for row in rows} == {"good-fraction", "resolution"}
    assert [line for line in lines if line.startswith("cross-position: left out: no part of dataset")]
    assert (output / "report" / "good-fraction.md").is_file()
    assert (output / "report" / "resolution.md").is_file()
    assert lines[-1].startswith("all: ")
    assert "alone, so there is nothing to compare it with" in gelgate("recommend", output).out
