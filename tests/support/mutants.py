"""`make mutants`: the program is changed in one place of a line, and the tests of its room must notice.

    python tests/support/mutants.py --diff main~5                  # every line that a diff has changed
    python tests/support/mutants.py edge/store edge/core --sample 60 --seed 1

The tests of a room run once under coverage, which says what tests run each line; those of a line are then run against
its mutant, the quickest first, in a copy of the program. A mutant that no test notices is printed: add its fact to a
test, or say why nothing can notice it. It is a plugin of pytest too, which notes the tests of each line.
"""

import argparse
import ast
import hashlib
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from threading import Lock

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[2]
# The folders of the tests of a room, where they have other names or are several: a mutant goes through them in turn.
TESTS_OF = {
    "edge/core": ("core", "gateway"),
    "edge/store": ("store", "gateway", "cli"),
    "edge/messaging": ("messaging", "gateway", "cli", "docs"),
    "edge/features": ("gateway",),
    "plugins/sinks": ("messaging",),
}
PAIRS = ["< <=", "> >=", "== !=", "is is_not", "in not_in", "and or", "+ -", "* /", "// %", "| &", "<< >>"]
SWAPPED = {
    a.replace("_", " "): b.replace("_", " ") for one in PAIRS for a, b in (one.split(), one.split()[::-1])
}
# What only people and type checkers read.
UNSEEN = re.compile(r"\s*(__all__|@|from |import |class |assert )|.*(TYPE_CHECKING|: .*Field\()")
# A test that takes three times as long with a mutant notices it, and this much more: it may be the first of a process.
START_S = 15.0
NOTED = "GELGATE_TESTS_OF_LINES"
# A file: how many times its seconds each test may take, and the seconds of each.
LIMITED = "GELGATE_TIMES_OF_TESTS"
ONE_AT_A_TIME = Lock()
Noted = tuple[dict[str, dict[str, list[str]]], dict[str, float]]
"""Path to line to its tests, and test to seconds; a test that fails without a mutant is in neither."""


@dataclass(frozen=True)
class Mutant:
    """A file whose line reads otherwise."""

    path: str
    line: int
    source: str
    before: str
    after: str
    readers: frozenset[int] | str
    """The lines of its file whose tests can notice it, or a name: the tests of all files that mention it can."""

    @property
    def folders(self) -> list[str]:
        """The folders of the tests of its room."""
        room = "/".join(self.path.split("/")[:2])
        return [f"tests/{name}" for name in TESTS_OF.get(room, (room.split("/")[1],))]


def change(node: ast.AST, source: bytes, starts: Sequence[int]) -> tuple[int, int, str] | None:
    """Return (start, end, new text) for a node that can be changed."""

    def span(one: ast.stmt | ast.expr) -> tuple[int, int]:
        first, last = starts[one.lineno - 1], starts[(one.end_lineno or 0) - 1]
        return first + one.col_offset, last + (one.end_col_offset or 0)

    match node:
        case (
            ast.Compare(left=left, comparators=[right])
            | ast.BoolOp(values=[left, right, *_])
            | ast.BinOp(left=left, right=right)
        ):
            begin, end = span(left)[1], span(right)[0]
            sign = re.search(rb"is\s+not|not\s+in|[a-z]+|[-+*/<>=!|&%]+", source[begin:end])
            new = sign and SWAPPED.get(" ".join(sign[0].decode().split()))
            return (begin + sign.start(), begin + sign.end(), new) if sign and new else None
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return *span(node), source[slice(*span(operand))].decode()
        case ast.Constant(value=bool() as value):
            return *span(node), str(not value)
        case ast.Constant(value=int() | float() as value):
            is_small = isinstance(value, int) and value < 100  # one more of a large number is no other one
            return *span(node), repr(value + 1 if is_small else 2 * value + type(value)(1))
        case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
            return *span(node), "return None"
        case ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Attribute()]) | ast.AugAssign():
            return *span(node), "pass"
        case ast.If(test=ast.Name() | ast.Attribute() | ast.Call() as test):
            return *span(test), f"not {source[slice(*span(test))].decode()}"
    return None


def is_sentence(node: ast.AST) -> bool:
    """Say whether it makes words for people: of a log line, an error, a text or a value that is printed."""
    match node:
        case ast.JoinedStr() | ast.Raise() | ast.Expr(ast.Call(ast.Attribute(ast.Name("log")))):
            return True
        case ast.keyword(arg="repr"):
            return True
    return False


def seen(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and what is below it, but for annotations, sentences and the -1 of a reshape: numpy takes any
    negative number for it."""
    yield node
    is_reshape = isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "reshape"
    for name, field in ast.iter_fields(node):
        for child in field if isinstance(field, list) else [field]:
            if isinstance(child, ast.AST) and name not in ("annotation", "returns"):
                is_any = is_reshape and isinstance(child, ast.UnaryOp)
                yield from () if is_sentence(child) or is_any else seen(child)


def readers_of(tree: ast.Module, line: int) -> frozenset[int] | str:
    """Return the lines whose tests can notice a mutant of a line: those of its statement. A line that runs at import
    does so in whichever test comes first: of such a line, those that read its private name, or the name of others."""
    every = [node for node in ast.walk(tree) if isinstance(node, ast.stmt)]
    functions = [node for node in every if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    inside = {at for one in functions for at in range(one.body[0].lineno, (one.end_lineno or 0) + 1)}
    around = [node for node in every if node.lineno <= line <= (node.end_lineno or 0)]
    calls = [one for one in ast.walk(tree) if isinstance(one, ast.Call) and one.lineno not in inside]
    at_import = {one.func.id for one in calls if isinstance(one.func, ast.Name)}
    if line in inside and not any(one in functions and one.name in at_import for one in around):
        statement = max(around, key=lambda node: node.lineno)
        body = getattr(statement, "body", None)
        end = max(line, body[0].lineno - 1) if body else statement.end_lineno or 0
        return frozenset(range(statement.lineno, end + 1))
    match min(around, key=lambda node: node.lineno):
        case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
            return name
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            loads = [node for node in ast.walk(tree) if isinstance(node, ast.Name) and node.id == name]
            uses = frozenset(node.lineno for node in loads if isinstance(node.ctx, ast.Load))
            return uses if name.startswith("_") and uses <= inside else name
    return r"\w"  # of no name: any file


def mutants_of(path: Path, lines: Sequence[int] | None, rng: random.Random) -> Iterator[Mutant]:
    """Yield one mutant of each of these lines that can be changed, of every line by default."""
    source, by_line = path.read_bytes(), defaultdict(list)
    shown = source.decode().splitlines()
    starts = [0]
    for text in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(text))
    tree = ast.parse(source)
    for node in seen(tree):
        if (found := change(node, source, starts)) is not None:
            by_line[source.count(b"\n", 0, found[0]) + 1].append(found)
    for line, places in sorted(by_line.items()):
        if (lines is None or line in lines) and not UNSEEN.match(shown[line - 1]):
            start, end, new = rng.choice(places)
            changed = (source[:start] + new.encode() + source[end:]).decode()
            after = changed.splitlines()[line - 1]
            readers = readers_of(tree, line)
            yield Mutant(str(path.relative_to(ROOT)), line, changed, shown[line - 1], after, readers)


def changed_lines(since: str) -> Mapping[str, list[int]]:
    """Read the lines that differ from a commit, by the path of their file."""
    diff = subprocess.check_output(
        ["git", "diff", "-U0", since, "--", "edge", "plugins"], cwd=ROOT, text=True
    )
    found: dict[str, list[int]] = defaultdict(list)
    path = ""
    for text in diff.splitlines():
        if text.startswith("+++ "):
            path = text[6:]
        elif part := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", text):
            found[path] += range(int(part[1]), int(part[1]) + int(part[2] or 1))
    return {path: lines for path, lines in found.items() if path.endswith(".py") and (ROOT / path).exists()}


class TestsOfLines:
    """Notes which tests run each line of the program, and how long each test takes."""

    __test__ = False

    def __init__(self) -> None:
        self.coverage = coverage.Coverage(data_file=None, source=[str(ROOT / "edge"), str(ROOT / "plugins")])
        self.coverage.set_option("run:disable_warnings", ["no-data-collected"])  # some tests read files alone
        self.coverage.start()
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.coverage.switch_context(item.nodeid)
        begun = time.process_time()
        result = yield
        self.seconds[item.nodeid] = time.process_time() - begun
        self.coverage.switch_context("")
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        data, noted = self.coverage.get_data(), defaultdict[str, Noted](lambda: ({}, {}))
        for test in self.seconds.keys() - self.failed:
            noted[test.split("::")[0]][1][test] = self.seconds[test]
        for file in data.measured_files():
            for line, tests in data.contexts_by_lineno(file).items():
                for test in set(tests) - self.failed - {""}:
                    by_line = noted[test.split("::")[0]][0].setdefault(str(Path(file).relative_to(ROOT)), {})
                    by_line.setdefault(str(line), []).append(test)
        Path(os.environ[NOTED]).write_text(json.dumps([noted, sorted(self.failed)]), encoding="utf-8")


class LimitOfEachTest:
    """Ends the process at a test that takes so many times its own seconds of the processor, or waits as long again."""

    def __init__(self, times: float, seconds: Mapping[str, float]) -> None:
        self.times, self.seconds = times, seconds
        self.allow(0.0)

    def allow(self, own_s: float) -> None:
        cpu_s = self.times * (START_S + own_s)
        most_s = resource.getrlimit(resource.RLIMIT_CPU)[1]
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time() + cpu_s), most_s))
        signal.setitimer(signal.ITIMER_REAL, 2 * cpu_s)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> None:
        self.allow(self.seconds.get(item.nodeid, 0.0))


def pytest_configure(config: pytest.Config) -> None:
    if NOTED in os.environ:
        config.pluginmanager.register(TestsOfLines())
    if LIMITED in os.environ:
        config.pluginmanager.register(LimitOfEachTest(*json.loads(Path(os.environ[LIMITED]).read_bytes())))


@cache
def tests_of_lines(folder: str, processes: int) -> Noted:
    """Return what the tests in a folder run; each of its files is measured once for a state of it and the program."""
    shared = {file for name in ("edge", "plugins", "tests/support") for file in (ROOT / name).rglob("*.py")}
    program = hash_of(sorted([*shared - {Path(__file__).resolve()}, *(ROOT / "tests").rglob("conftest.py")]))
    files = sorted((ROOT / folder).rglob("test_*.py"))
    kept = {
        str(file.relative_to(ROOT)): ROOT / f".mutants/{file.stem}-{program}-{hash_of([file])}.json"
        for file in files
    }
    if new := [name for name, path in kept.items() if not path.exists()]:
        print(f"{folder}: tests run once under coverage, of {len(new)} files", flush=True)
        (ROOT / ".mutants").mkdir(exist_ok=True)

        def measure(names: Sequence[str]) -> None:
            with tempfile.NamedTemporaryFile("r", suffix=".json", encoding="utf-8") as noted:
                outcome = run(ROOT, names, {NOTED: noted.name})
                found, failed = json.load(noted)
            if outcome != "passed" and not failed:
                sys.exit(f"pytest cannot run the tests in {folder}; run them")
            for test in failed:
                print(f"left out, for it fails without a mutant: {test}", flush=True)
            for name in names:
                kept[name].write_text(json.dumps(found.get(name, ({}, {}))), encoding="utf-8")

        # Several shares for each process: no one waits long for the last, and what is measured at an end is kept.
        shares = min(len(new), 4 * processes)
        with ThreadPoolExecutor(processes) as threads:
            list(threads.map(measure, [new[number::shares] for number in range(shares)]))
    lines, seconds = defaultdict[str, dict[str, list[str]]](dict), dict[str, float]()
    for path in kept.values():
        of_file, took = json.loads(path.read_text(encoding="utf-8"))
        seconds |= took
        for name, by_line in of_file.items():
            for line, tests in by_line.items():
                lines[name].setdefault(line, []).extend(tests)
    return lines, seconds


def hash_of(files: Sequence[Path]) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def run(tree: Path, tests: Sequence[str], variables: Mapping[str, str]) -> str:
    """Run these tests against the program in a folder. Return "passed", "failed" or "late"."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as named:
        named.write("\n".join(tests))
        named.flush()
        first = () if NOTED in variables else ("-x",)
        words = ["pytest", "-q", *first, "-p", "mutants", "-p", "no:cacheprovider", f"@{named.name}"]
        environment = {**os.environ, "PYTHONPATH": f"{tree}:{tree / 'tests/support'}", **variables}
        command = [sys.executable, "-m", *words]
        status = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, check=False
        ).returncode
    # pytest ends with 5 where a file has no test that is selected.
    return {0: "passed", 5: "passed", -signal.SIGXCPU: "late", -signal.SIGALRM: "late"}.get(status, "failed")


def run_within(tree: Path, tests: Sequence[str], times: float, seconds: Mapping[str, float]) -> str:
    """Run them, each for at most so many times its seconds."""
    limits = tree / "times_of_tests.json"
    limits.write_text(json.dumps([times, {test: seconds.get(test, 0.0) for test in tests}]), encoding="utf-8")
    return run(tree, tests, {LIMITED: str(limits)})


def judge(mutant: Mutant, tree: Path, processes: int) -> str:
    """Run the tests of its readers. A mutant that is late is killed only where the program passes in a third of the
    time at once afterwards: a machine that is busy, or a test that takes long by itself, notices nothing."""
    path = tree / mutant.path
    sound = path.read_bytes()
    for folder in mutant.folders:
        with ONE_AT_A_TIME:
            lines, seconds = tests_of_lines(folder, processes)
        if isinstance(mutant.readers, str):
            mention = re.compile(rf"\b{mutant.readers}\b")
            files = [
                lines[name] for name in lines if mention.search((ROOT / name).read_text(encoding="utf-8"))
            ]
            tests = {test for by_line in files for named in by_line.values() for test in named}
        else:
            of_file = lines.get(mutant.path, {})
            tests = {test for line in mutant.readers for test in of_file.get(str(line), ())}
        if not tests:
            continue
        in_order = sorted(tests, key=lambda test: seconds.get(test, 0.0))
        path.write_text(mutant.source, encoding="utf-8")
        try:
            outcome = run_within(tree, in_order, 3, seconds)
        finally:
            path.write_bytes(sound)
        if outcome == "late" and run_within(tree, in_order, 1, seconds) != "passed":
            return "not tried"
        if outcome != "passed":
            return "killed"
    return "survived"


def main() -> int:
    words = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    words.add_argument("paths", nargs="*", help="files and folders of the program")
    words.add_argument("--diff", help="a commit: the lines that differ from it")
    words.add_argument("--sample", type=int, help="at most so many mutants; default: all")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--minutes", type=float, default=30.0, help="begin none later")
    words.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    given = words.parse_args()
    rng, lines = random.Random(given.seed), changed_lines(given.diff) if given.diff else {}
    files = [file for name in given.paths for file in sorted((ROOT / name).rglob("*.py")) or [ROOT / name]]
    wanted = [*((ROOT / path, numbers) for path, numbers in lines.items()), *((file, None) for file in files)]
    mutants = [mutant for path, numbers in wanted for mutant in mutants_of(path, numbers, rng)]
    mutants = rng.sample(mutants, min(given.sample or len(mutants), len(mutants)))
    end, outcomes = time.monotonic() + 60 * given.minutes, Counter[str]()
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor(given.processes) as threads:
        trees: SimpleQueue[Path] = SimpleQueue()
        for number in range(given.processes):
            hidden = shutil.ignore_patterns("__pycache__", ".*", "*.egg-info", "build")
            trees.put(shutil.copytree(ROOT, Path(made, str(number)), ignore=hidden, symlinks=True))

        def take(mutant: Mutant) -> None:
            tree = trees.get()
            outcome = judge(mutant, tree, given.processes) if time.monotonic() < end else "not tried"
            trees.put(tree)
            outcomes[outcome] += 1
            if outcome == "survived":
                print(f"{mutant.path}:{mutant.line}\n  -{mutant.before}\n  +{mutant.after}", flush=True)

        list(threads.map(take, mutants))
    killed, survived = outcomes["killed"], outcomes["survived"]
    print(
        f"{killed} of {killed + survived} mutants killed, {outcomes['not tried']} not tried for want of time"
    )
    return 1 if survived else 0


if __name__ == "__main__":
    sys.exit(main())
