"""The first run of a bundle, in a child process with limits of time and memory.

A graph can be made that computes for ever or fills the memory, and onnxruntime has no limit of its own. The child loads
the bundle, runs its graphs and scores its golden frames, as a start does.
"""

import json
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from edge.core.errors import BundleCorrupt, GelgateError

__all__ = ["TRIAL", "Limits", "try_bundle"]

# Exit codes of the child.
REFUSED: Final = 3


@dataclass(frozen=True)
class Limits:
    """seconds: of wall clock. memory_bytes: of address space beyond that of the program itself, which takes 2 GB."""

    seconds: float = 120.0
    memory_bytes: int = 8 << 30


TRIAL: Final = Limits()
"""The slowest shipped method needs 3 s and 1.5 GB on two cores."""


def try_bundle(path: Path, trunks: Path | None = None, threads: int = 2, limits: Limits = TRIAL) -> None:
    """Run the bundle once. Errors: BundleCorrupt when it does not end in time, needs more memory, or is refused."""
    task = json.dumps([str(path), trunks and str(trunks), threads, asdict(limits)])
    try:
        done = subprocess.run(
            [sys.executable, "-m", "edge.model.trial", task],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limits.seconds,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        raise BundleCorrupt(
            f"bundle {path}: its first run did not end within {limits.seconds:g} s, so it cannot inspect; fit or "
            "export it again"
        ) from None
    if done.returncode == REFUSED:
        raise BundleCorrupt(done.stdout.strip())
    if done.returncode != 0:
        last = "".join(done.stderr.strip().splitlines()[-1:])
        raise BundleCorrupt(
            f"bundle {path}: its first run ended without a score ({last or f'exit code {done.returncode}'}); at most "
            f"{limits.memory_bytes >> 20} MB are given to it; fit or export it again"
        )


def _main(task: str) -> int:
    path, trunks, threads, limits = json.loads(task)
    memory, seconds = Limits(**limits).memory_bytes, Limits(**limits).seconds
    from edge.model.bundle import Bundle
    from edge.model.scorer import Scorer

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
    # The parent may be killed while it waits: then the time of the processor ends the child.
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds * threads) + 1, int(seconds * threads) + 2))
    try:
        Scorer(Bundle.load(path, trunks and Path(trunks)), threads).check_golden()
    except GelgateError as error:
        print(error)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
