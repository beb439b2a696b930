"""The first run of a bundle, in a child process with limits of time and memory.

A graph can be made that computes for ever or fills the memory, and onnxruntime has no limit of its own. The child loads
the bundle, runs its graphs and scores its golden frames, as a start does.
"""

import contextlib
import json
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

from edge.core.errors import BundleCorrupt, GelgateError

__all__ = ["try_bundle"]

# Exit codes of the child.
REFUSED: Final = 3


SECONDS: Final = 120.0
"""Of wall clock. The slowest shipped method needs 3 s and 1.5 GB on two cores."""
MEMORY_BYTES: Final = 8 << 30
"""Of address space beyond that of the program itself, which takes 2 GB."""


def try_bundle(
    path: Path,
    trunks: Path | None = None,
    threads: int = 2,
    *,
    seconds: float = SECONDS,
    memory_bytes: int = MEMORY_BYTES,
) -> None:
    """Run the bundle once. Errors: BundleCorrupt when it does not end in time, needs more memory, or is refused."""
    task = json.dumps([str(path), trunks and str(trunks), threads, seconds, memory_bytes])
    try:
        done = subprocess.run(
            [sys.executable, "-m", "edge.model.trial", task],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=seconds,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        raise BundleCorrupt(
            f"bundle {path}: its first run did not end within {seconds:g} s, so it cannot inspect; fit or "
            "export it again"
        ) from None
    if done.returncode == 0:
        return
    output = done.stdout.strip()
    if done.returncode == REFUSED and "allocate memory" not in output:
        raise BundleCorrupt(output)
    last = "".join((output or done.stderr.strip()).splitlines()[-1:]) or f"exit code {done.returncode}"
    if done.returncode == -signal.SIGKILL:
        last = "it was killed, as where the memory is full"
    raise BundleCorrupt(
        f"bundle {path}: its first run ended without a score ({last}); {_most(memory_bytes)} are given to it; allow "
        "more, or fit or export it again"
    )


def _most(memory_bytes: int) -> str:
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed == resource.RLIM_INFINITY:
        return f"at most {memory_bytes >> 20} MB"
    return f"by `ulimit -v` or LimitAS= at most {allowed >> 20} MB"


def _main(task: str) -> int:
    path, trunks, threads, seconds, memory = json.loads(task)
    from edge.model.bundle import Bundle
    from edge.model.scorer import Scorer

    with contextlib.suppress(OSError):  # where memory is short, this ends and not the gateway
        Path("/proc/self/oom_score_adj").write_text("1000")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _limit(resource.RLIMIT_AS, used + memory)
    # The parent may be killed while it waits: then the time of the processor ends the child.
    _limit(resource.RLIMIT_CPU, int(seconds * threads) + 1)
    try:
        Scorer(Bundle.load(path, trunks and Path(trunks)), threads).check_golden()
    except GelgateError as error:
        print(error)
        return REFUSED
    return 0


def _limit(what: int, most: int) -> None:
    """A lower limit that the process has already stays."""
    limits = [limit for limit in (most, *resource.getrlimit(what)) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(what, (min(limits), min(limits)))


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
