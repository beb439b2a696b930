"""`.ci/vex.py` tells what is known against the packages, and never says "nothing known" of a silent database."""

import json
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest
from scripts import load_script

from edge.cli.bill_of_materials import bill_of_materials

# A weakness of flask 0.5 as pip-audit 2.10 prints it (its JsonFormat), here said of numpy.
RECORDED = [
    {
        "id": "PYSEC-2019-179",
        "fix_versions": ["1.0"],
        "aliases": ["GHSA-5wv5-4vpf-pj6m", "CVE-2019-1010083"],
        "description": "The Pallets Project Flask before 1.0 is affected by: unexpected memory usage.",
    }
]
STATEMENT = """
[[statement]]
id = "CVE-2019-1010083"
package = "numpy"
state = "not_affected"
justification = "code_not_reachable"
detail = "No text of a message is decoded by it."
"""


@cache
def bill() -> str:
    """The bill of what is installed, which takes a second."""
    return bill_of_materials([])


@pytest.fixture
def vex(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    module = load_script(".ci/vex.py")
    monkeypatch.setattr(module, "bill_of_materials", lambda bundles: bill())
    monkeypatch.setattr(module, "STATEMENTS", tmp_path / "vex.toml")
    (tmp_path / "vex.toml").touch()
    return module


def pip_audit(folder: Path, *, known: dict[str, list[object]], unknown: str = "") -> str:
    """A program that answers as pip-audit does, for each package of the file that it is given."""
    program = folder / "pip-audit"
    program.write_text(
        f"""#!{sys.executable}
import json, sys
known, unknown = {known!r}, {unknown!r}
print("No known vulnerabilities found", file=sys.stderr)
lines = [line.strip().split("==") for line in open(sys.argv[2])]
print(json.dumps({{"fixes": [], "dependencies": [
    {{"name": name, "skip_reason": "Dependency not found on PyPI"}} if name == unknown
    else {{"name": name, "version": version, "vulns": known.get(name, [])}} for name, version in lines]}}))
""",
        encoding="utf-8",
    )
    program.chmod(0o755)
    return str(program)


def test_a_weakness_is_told_with_its_statement_and_is_open_without_one(
    vex: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A statement names it by another of its numbers; without it the command fails, and the document says so."""
    output, program = tmp_path / "bill.json", pip_audit(tmp_path, known={"numpy": RECORDED})

    with pytest.raises(SystemExit, match=r"PYSEC-2019-179 of pkg:pypi/numpy@.* is in_triage"):
        vex.main(program, output)
    undecided = json.loads(output.read_text())
    vex.STATEMENTS.write_text(STATEMENT)
    vex.main(program, output)
    decided = json.loads(output.read_text())

    assert undecided["vulnerabilities"][0]["analysis"] == {"state": "in_triage"}
    assert decided["vulnerabilities"][0]["affects"] == [{"ref": f"pkg:pypi/numpy@{version('numpy')}"}]
    assert decided["vulnerabilities"][0]["analysis"]["justification"] == "code_not_reachable"
    assert decided["serialNumber"] != undecided["serialNumber"]
    assert "1 weaknesses known, 0 open" in capsys.readouterr().out


def test_a_package_that_the_database_does_not_know_is_no_good_news(vex: ModuleType, tmp_path: Path) -> None:
    """pip-audit says "No known vulnerabilities found" of it; here that is not repeated, nothing is written, and an
    older document goes."""
    for program in (pip_audit(tmp_path, known={}, unknown="numpy"), "/bin/false"):
        (tmp_path / "bill.json").write_text("{}")
        with pytest.raises(SystemExit, match="UNKNOWN, NOT CHECKED: pip-audit has no answer for") as ended:
            vex.main(program, tmp_path / "bill.json")

        assert "No known vulnerabilities" not in str(ended.value)
        assert not (tmp_path / "bill.json").exists()
