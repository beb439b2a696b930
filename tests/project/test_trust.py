"""What outside tools say of the repository. The tools have an environment of their own: `make test-trust`."""

import json
import os
import subprocess
import tomllib
from pathlib import Path

import pytest
import tiny
from scripts import load_script

from edge.cli.bill_of_materials import bill_of_materials
from edge.model.bundle_writer import write_bundle

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
        ("check-jsonschema", "--builtin-schema", "vendor.citation-file-format", "CITATION.cff"),
    ],
    ids=lambda words: words[0],
)
def test_a_judge_finds_nothing(words: tuple[str, ...]) -> None:
    done = run_judge(*words)

    assert done.returncode == 0, done.stdout + done.stderr


VALIDATE = """
import sys
from pathlib import Path
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
sys.exit(str(JsonStrictValidator(SchemaVersion.V1_6).validate_str(Path(sys.argv[1]).read_text()) or "") or None)
"""


@pytest.mark.trust
def test_a_bill_of_materials_is_as_the_schema_of_cyclonedx_says(tmp_path: Path) -> None:
    """All packages of this environment, a bundle and its trunk, and a weakness (`make vex`); a wrong word is found."""
    _, files = tiny.tiny_files(tiny.tiny_bank())
    bill, wrong = tmp_path / "bill.json", tmp_path / "wrong.json"
    content = json.loads(bill_of_materials([write_bundle(tmp_path / "bolt", files)]))
    package = next(one for one in content["components"] if one["name"] == "numpy")
    weakness = {"id": "PYSEC-2019-179", "aliases": ["CVE-2019-1010083"], "description": "Memory."}
    statement = {
        "id": "CVE-2019-1010083",
        "package": "numpy",
        "state": "not_affected",
        "detail": "Never called.",
    }
    content["vulnerabilities"] = [
        load_script(".ci/vex.py").describe(weakness, package["bom-ref"], "numpy", [statement])
    ]
    bill.write_text(json.dumps(content))
    wrong.write_text(bill.read_text().replace('"library"', '"book"'))

    done = run_judge("python", "-c", VALIDATE, str(bill))
    assert done.returncode == 0, done.stderr[:500]
    assert "book" in run_judge("python", "-c", VALIDATE, str(wrong)).stderr


def test_three_rules_of_scientific_python_are_not_kept_and_each_has_its_reason() -> None:
    """A fourth is a decision: a sentence in pyproject.toml, and a change here."""
    ignored = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["repo-review"]["ignore"]

    assert len(ignored) <= 3
    assert all(len(reason.split()) > 8 for reason in ignored.values())
