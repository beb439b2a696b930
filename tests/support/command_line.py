"""The command line in this process: what `gelgate ...` prints, and the exit code it ends with."""

import contextlib
import io
import logging
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from edge.cli import main

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "score_bundle.py"


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str

    def sentence(self) -> str:
        """What a refusal said. Errors: AssertionError when it is not one refusal without a traceback."""
        assert "Traceback" not in self.err, self.err
        lines = [line for line in self.err.splitlines() if line.startswith("gelgate: ")]
        assert len(lines) == 1, self.err
        return self.err[self.err.index("gelgate: ") + len("gelgate: ") :].rstrip("\n")


def gelgate(*arguments: object) -> Outcome:
    """Run one command to its end. Signal handlers and log handlers are put back as they were."""
    out, err = io.StringIO(), io.StringIO()
    handlers, level = logging.root.handlers[:], logging.root.level
    signals = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with (
            mock.patch.object(sys, "argv", ["gelgate", *map(str, arguments)]),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    finally:
        logging.root.handlers[:] = handlers
        logging.root.setLevel(level)
        for number, handler in signals.items():
            signal.signal(number, handler)
    return Outcome(code, out.getvalue(), err.getvalue())


def ran(*arguments: object) -> str:
    """Run one command that succeeds; return what it prints on both outputs."""
    done = gelgate(*arguments)
    assert done.code == 0, done.err
    return done.out + done.err


def refuse_by_example(bundle: Path) -> str:
    """Return what examples/score_bundle.py, which has nothing of gelgate, says of a bundle that it refuses."""
    done = subprocess.run([sys.executable, "-I", str(EXAMPLE), str(bundle)], capture_output=True, text=True)
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    return done.stderr
