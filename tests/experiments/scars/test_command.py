"""The figures of `gelgate lab evaluate-scars`, and what it refuses."""

import pytest
from command_line import gelgate

from calibration.experiments.scars.command import Alarm, format_rate, table


def alarm(truth: str, cause: str, placing: str = "thread in a fixture") -> Alarm:
    return {"placing": placing, "truth": truth, "cause": cause, "what": "dent"}


def test_no_wrong_name_in_230_is_one_per_cent_at_most() -> None:
    """1 - 0.1 ** (1 / 230) = 0.996 %; of as many right names, 99 % at least."""
    assert format_rate(0, 230) == "0.0% (0 of 230; 0.0% to 1.0%)"
    assert format_rate(230, 230) == "100.0% (230 of 230; 99.0% to 100.0%)"


def test_the_table_counts_causes_by_what_raised_the_alarm() -> None:
    """Three scars named gel twice, two of damage named part."""
    alarms = [*[alarm("scar", "gel")] * 2, alarm("scar", "unsure"), *[alarm("damage", "part", "other")] * 2]
    text = " ".join(table(alarms, 40).split())

    assert "40 presses, 5 alarms" in text
    assert "| a scar, the part is sound | 3 | 66.7% (2 of 3;" in text
    assert "| thread in a fixture | 2 of 3 | 0 of 0 |" in text
    assert "| other | 0 of 0 | 0 of 2 |" in text


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
