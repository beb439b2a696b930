"""What outside tools say of the repository. The tools have an environment of their own: `make test-trust`."""

import os
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run_judge(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a tool of the environment that `make test-trust` has made."""
    program = Path(os.environ["GELGATE_TRUST"], words[0])
    return subprocess.run([program, *words[1:]], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.trust
@pytest.mark.parametrize(
    "words",
    [
        ("repo-review", "."),
        ("zizmor", "--offline", "."),
        ("codespell",),
        ("pre-commit", "validate-config"),
        ("reuse", "lint"),
        ("cffconvert", "--validate"),
    ],
    ids=lambda words: words[0],
)
def test_a_judge_finds_nothing(words: tuple[str, ...]) -> None:
    """Each of them, with what pyproject.toml tells it."""
    done = run_judge(*words)

    assert done.returncode == 0, done.stdout + done.stderr


def test_three_rules_of_scientific_python_are_not_kept_and_each_has_its_reason() -> None:
    """A fourth is a decision: a sentence in pyproject.toml, and a change here."""
    ignored = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["repo-review"]["ignore"]

    assert len(ignored) <= 3
    assert all(len(reason.split()) > 8 for reason in ignored.values())
