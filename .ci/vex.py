"""Write the bill of materials of this environment, with what is known against its packages and what that means (VEX).

    python .ci/vex.py PIP_AUDIT OUTPUT

pip-audit asks the database of PyPI. Without an answer for every package there is no document: silence is no good news.
deploy/vex.toml has the statements, kept by hand; a weakness without one stands as `in_triage`, and the end is 1.
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from edge.cli.bill_of_materials import bill_of_materials

STATEMENTS = Path(__file__).resolve().parents[1] / "deploy/vex.toml"
KEYS = {"id", "package", "state", "justification", "detail"}


def main(pip_audit: str, output: Path) -> None:
    """Write the document; end with a sentence and 1 where something is unknown, undecided, or exploitable. An older
    document goes: it would be taken for an answer of now."""
    output.unlink(missing_ok=True)
    bill = json.loads(bill_of_materials([]))
    packages = {
        component["purl"].removeprefix("pkg:pypi/"): component["bom-ref"]
        for component in bill["components"]
        if component.get("purl", "").startswith("pkg:pypi/")
    }
    statements = tomllib.loads(STATEMENTS.read_text(encoding="utf-8")).get("statement", [])
    answers = ask(pip_audit, sorted(packages))
    known = [
        describe(weakness, packages[f"{answer['name']}@{answer['version']}"], answer["name"], statements)
        for answer in answers
        for weakness in answer["vulns"]
    ]
    bill["vulnerabilities"] = known
    bill["serialNumber"] = f"urn:uuid:{uuid5(NAMESPACE_URL, bill['serialNumber'] + json.dumps(known))}"
    output.write_text(json.dumps(bill, indent=2) + "\n", encoding="utf-8")
    open_ones = [
        f"{weakness['id']} of {weakness['affects'][0]['ref']} is {weakness['analysis']['state']}"
        for weakness in known
        if weakness["analysis"]["state"] in ("in_triage", "exploitable")
    ]
    print(f"{output}: {len(packages)} packages asked, {len(known)} weaknesses known, {len(open_ones)} open")
    if open_ones:
        sys.exit("; ".join(open_ones) + f"; {STATEMENTS.name} takes a statement, or a newer version mends it")


def ask(pip_audit: str, packages: list[str]) -> list[dict[str, Any]]:
    """Return what pip-audit says of each package. Ends with 1 where it cannot say it of all."""
    with NamedTemporaryFile("w", suffix=".txt") as pinned:
        pinned.write("".join(f"{package.replace('@', '==')}\n" for package in packages))
        pinned.flush()
        words = [pip_audit, "-r", pinned.name, "--no-deps", "--disable-pip", "--format", "json"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    try:
        dependencies = json.loads(done.stdout)["dependencies"]
        # Not its last words: they are "No known vulnerabilities found" where it has asked about none.
        why = next(
            (dependency["skip_reason"] for dependency in dependencies if "skip_reason" in dependency), ""
        )
    except ValueError:
        dependencies, why = [], done.stderr[-300:]
    answers = {
        f"{dependency['name']}@{dependency['version']}": dependency
        for dependency in dependencies
        if "vulns" in dependency
    }
    if missing := [package for package in packages if package not in answers]:
        sys.exit(
            f"UNKNOWN, NOT CHECKED: pip-audit has no answer for {len(missing)} of {len(packages)} packages, "
            f"such as {missing[0]}; there is no document. Is the database of PyPI reachable? {why}"
        )
    return list(answers.values())


def describe(
    weakness: dict[str, Any], reference: str, package: str, statements: list[dict[str, str]]
) -> dict[str, Any]:
    """Return a weakness as CycloneDX has it, with the statement that names it by any of its numbers."""
    numbers = [weakness["id"], *weakness["aliases"]]
    analysis = {"state": "in_triage"}
    for statement in statements:
        if unknown := statement.keys() - KEYS:
            sys.exit(
                f"{STATEMENTS.name}: {', '.join(sorted(unknown))} is unknown; a statement has {', '.join(sorted(KEYS))}"
            )
        if statement["id"] in numbers and statement["package"] == package:
            analysis = {key: value for key, value in statement.items() if key not in ("id", "package")}
    return {
        "id": weakness["id"],
        "description": weakness["description"],
        "affects": [{"ref": reference}],
        "references": [
            {"id": number, "source": {"name": number.partition("-")[0]}} for number in sorted(numbers[1:])
        ],
        "analysis": analysis,
    }


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
