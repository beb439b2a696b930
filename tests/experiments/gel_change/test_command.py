"""The figures of `gelgate lab evaluate-new-gel`, and what it refuses."""

import pytest
from command_line import gelgate

from calibration.experiments.gel_change.command import AGAIN, BEFORE, WAYS, Row, table


def test_the_table_has_means_and_losses_against_pressing_again() -> None:
    """Worked by hand: two parts lose .04 and -.02, so .01 in the mean and .04 at most."""
    names = ("part", "method", "way", "aupro", "auroc", "false_alarms", "detected")
    rows: list[Row] = [
        dict(zip(names, row, strict=True))
        for row in (
            ("a", "padim", BEFORE, None, None, 0.0, None),
            ("a", "padim", "limit", 0.60, 0.9, 0.1, 0.8),
            ("b", "padim", "limit", 0.70, 1.0, 0.0, 0.6),
            ("a", "padim", AGAIN, 0.64, 1.0, 0.0, 0.9),
            ("b", "padim", AGAIN, 0.68, 1.0, 0.0, 0.9),
        )
    ]
    text = " ".join(table(rows).split())

    assert text.startswith("2 parts, each on two gels")
    assert "| old gel | - | - | - | - | 0.000 | - |" in text
    assert "| limit | 0.650 | +0.010 | +0.040 | 0.950 | 0.050 | 0.700 |" in text
    assert all(f"- `{way}`: {what}." in text for way, what in WAYS.items())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--set", "judgment"], "no set is named 'judgment'; did you mean 'judgement'?"),
        (["--method", "padimm"], "no detector of this study is named 'padimm'; did you mean 'padim'?"),
        (
            ["--json", "/nowhere/x.json"],
            "'/nowhere/x.json' cannot be written; name a file in an existing folder",
        ),
    ],
)
def test_what_it_does_not_know_is_one_sentence(arguments: list[str], sentence: str) -> None:
    """Before any work is done."""
    assert gelgate("lab", "evaluate-new-gel", *arguments).sentence() == sentence
