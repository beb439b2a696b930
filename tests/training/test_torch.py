"""Whether training is tested here at all."""

import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from edge.extras import is_installed

ROOT = Path(__file__).resolve().parents[2]
SKIPPED = (
    "SKIPPED, NOT TESTED: training of the backbone needs torch; `make test-train` installs it and tests that"
)


@pytest.mark.skipif(not is_installed("torch"), reason=SKIPPED)
def test_the_torch_that_training_is_tested_with_is_one_that_the_extra_allows() -> None:
    """The version installed here lies in the range of `gelgate[train]`."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = next(one for one in map(Requirement, extras["train"]) if one.name == "torch")

    assert wanted.specifier.contains(version("torch"))
