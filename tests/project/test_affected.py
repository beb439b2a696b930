"""`.ci/affected.py` chooses the tests of `make check`."""

import pytest
from scripts import load_script

TEXTS = {
    "tests/project/test_shape.py": "",
    "tests/project/test_boundaries.py": "",
    "tests/docs/test_pages.py": "",
    "tests/core/test_verdict.py": "from edge.core.verdict import decide\n",
    "tests/core/test_verdict_words.py": "from edge.core import errors, verdict\n",
    "tests/core/test_verdicts.py": "from edge.core.verdicts import decide\n",
    "tests/model/test_scorer.py": "import tiny\n",
    "tests/support/tiny.py": "from edge.core.verdict import decide\n",
}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("edge/core/verdict.py", {"tests/core/test_verdict.py", "tests/core/test_verdict_words.py"}),
        ("tests/support/tiny.py", {"tests/model/test_scorer.py"}),
        ("tests/core/test_verdicts.py", {"tests/core/test_verdicts.py"}),
        ("tests/core/test_that_was_removed.py", set()),
        ("docs/gel.md", {"tests/docs/test_pages.py"}),
        ("edge/cli/gel.py", {"tests/docs/test_pages.py"}),
        ("Makefile", set()),
    ],
)
def test_what_imports_the_changed_is_chosen_and_the_rules_always(changed: str, expected: set[str]) -> None:
    """Neither a longer name nor a module of the support is taken for a test of it."""
    affected = load_script(".ci/affected.py")

    always = {"tests/project/test_shape.py", "tests/project/test_boundaries.py"}
    assert set(affected.choose_tests([changed], TEXTS)) == always | expected
