"""The torch that training is tested with."""

import tomllib
from importlib.metadata import version
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]


def test_the_torch_that_training_is_tested_with_is_one_that_the_extra_allows() -> None:
    """The version installed here lies in the range of `gelgate[train]`."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = next(one for one in map(Requirement, extras["train"]) if one.name == "torch")

    assert wanted.specifier.contains(version("torch"))
