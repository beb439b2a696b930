"""Print the tests that a change can break first: those that were changed, and those that import what was changed.

    python .ci/affected.py main

`make test` has the others: a test that sees a module through three more is not found here.
"""

import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

PACKAGES = ("gelgate", "edge", "plugins", "calibration", "export")
ALWAYS = ("tests/project/test_shape.py", "tests/project/test_boundaries.py")
"""The rules of CONTRIBUTING.md that are tests."""
PAGES = ("tests/docs/test_pages.py", "tests/docs/test_readme.py")
"""What a change of a page, of help or of the configuration breaks."""


def choose_tests(changed: Iterable[str], texts: Mapping[str, str]) -> list[str]:
    """Return test files. changed: paths in the repository. texts: what is in tests/, by path."""
    chosen = set(ALWAYS)
    for path in changed:
        if path.endswith(".md") or path.startswith(("edge/cli/", "edge/config/", "edge/messaging/")):
            chosen.update(PAGES)
        if path.split("/")[0] in PACKAGES and path.endswith(".py"):
            module = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
            chosen.update(find_users(module, texts))
        elif path.startswith("tests/support/"):
            chosen.update(find_users(Path(path).stem, texts))
        elif Path(path).name.startswith("test_"):
            chosen.add(path)
    return sorted(chosen & texts.keys())


def find_users(module: str, texts: Mapping[str, str]) -> list[str]:
    """Return the test files that import a module, or something from it."""
    package, _, name = module.rpartition(".")
    forms = [rf"(from|import) {re.escape(module)}\b"]
    if package:
        forms.append(rf"from {re.escape(package)} import [^\n]*\b{name}\b")
    uses = re.compile("|".join(forms))
    return [path for path, text in texts.items() if Path(path).name.startswith("test_") and uses.search(text)]


def list_changes(base: str) -> list[str]:
    """Return what differs from the branch, committed or not, and what git does not know yet."""
    changed = ["git", "diff", "--name-only", "--merge-base", base]
    new = ["git", "ls-files", "--others", "--exclude-standard"]
    done = [subprocess.run(words, check=True, capture_output=True, text=True) for words in (changed, new)]
    return [line for path in done for line in path.stdout.splitlines()]


if __name__ == "__main__":
    files = {path.as_posix(): path.read_text(encoding="utf-8") for path in Path("tests").rglob("*.py")}
    print(*choose_tests(list_changes(sys.argv[1]), files), sep="\n")
