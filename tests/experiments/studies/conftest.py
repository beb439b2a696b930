"""A file of rows, and an evaluation that counts its runs."""

from pathlib import Path

import pytest
from study_cells import Counted

from calibration.experiments.harness.rows import Rows


@pytest.fixture
def counted(tmp_path: Path) -> Counted:
    (tmp_path / "ran").mkdir()
    return Counted(tmp_path / "ran")


@pytest.fixture
def rows(tmp_path: Path) -> Rows:
    return Rows(tmp_path / "rows.jsonl")
