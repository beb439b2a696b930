"""The figures of `gelgate lab evaluate-new-gel`, and what it refuses."""

import pytest
from command_line import gelgate


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
