"""The figures of `gelgate lab evaluate-scars`, and what it refuses."""

import pytest
from command_line import gelgate

from calibration.experiments.scars.command import format_rate


def test_no_wrong_name_in_230_is_one_per_cent_at_most() -> None:
    """1 - 0.1 ** (1 / 230) = 0.996 %; of as many right names, 99 % at least."""
    assert format_rate(0, 230) == "0.0% (0 of 230; 0.0% to 1.0%)"
    assert format_rate(230, 230) == "100.0% (230 of 230; 99.0% to 100.0%)"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--set", "judgment"], "no set is named 'judgment'; did you mean 'judgement'?"),
        (
            ["--placing", "thread in fixture"],
            "no placing is named 'thread in fixture'; did you mean 'thread in a fixture'?",
        ),
        (
            ["--json", "/nowhere/x.json"],
            "'/nowhere/x.json' cannot be written; name a file in an existing folder",
        ),
    ],
)
def test_what_it_does_not_know_is_one_sentence(arguments: list[str], sentence: str) -> None:
    """Before any work is done."""
    assert gelgate("lab", "evaluate-scars", *arguments).sentence() == sentence
