"""Rows of which no page can be made. What a page says of its rows is compared in tests/docs/test_studies.py."""

from pathlib import Path

import pytest
from command_line import gelgate

from calibration.experiments.studies.report import write_report
from edge.core.errors import ConfigError


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
    (tmp_path / "rows.jsonl").write_text('{"format": 1, "key": "a", "study": "good-fraction"}\n')
    (tmp_path / "file").write_text("")

    with pytest.raises(ConfigError, match="file cannot be a folder: File exists; choose another place"):
        write_report(tmp_path, tmp_path / "file")
