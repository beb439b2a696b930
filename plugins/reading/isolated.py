"""`read_foreign`: a foreign file read in a process of its own, so that nothing in it can touch this one."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edge.core.errors import ConfigError
from plugins.reading.child import decode
from plugins.reading.files import MOST_BYTES
from plugins.reading.foreign import Foreign

__all__ = ["read_foreign"]

# Memory for the interpreter and NumPy, which maps much that it does not use; a file's bytes may be held three times.
BASE_BYTES = 2 << 30
COPIES = 3
BASE_S, S_PER_GIB = 60, 60


@contextmanager
def read_foreign(path: Path) -> Iterator[Foreign]:
    """Read what a foreign file holds, for as long as the context lasts; its arrays are in a temporary folder.

    Errors: ConfigError that names the file and what it is instead.
    """
    try:
        size = path.stat().st_size
        with path.open("rb"):
            pass
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read: {error.strerror}; give the file of a trained detector"
        ) from error
    if size > MOST_BYTES:
        raise ConfigError(f"{path} has {size >> 20} MiB, {MOST_BYTES >> 20} MiB are allowed")
    with tempfile.TemporaryDirectory(prefix="gelgate-import-") as folder:
        out = Path(folder)
        _run(path, out, size)
        answer = json.loads((out / "content.json").read_text())
        if "error" in answer:
            raise ConfigError(f"{path} was not imported: {answer['error']}")
        yield Foreign(path, answer["form"], decode(answer["values"], out), answer["isolation"])


def _run(path: Path, out: Path, size: int) -> None:
    """Read the file in a process of its own. Errors: ConfigError where it ends without an answer."""
    seconds = BASE_S + S_PER_GIB * (size >> 30)
    limits = (BASE_BYTES + COPIES * size, seconds, COPIES * size + (64 << 20))
    command = [
        sys.executable,
        "-P",
        "-m",
        "plugins.reading.child",
        str(path.absolute()),
        str(out),
        *map(str, limits),
    ]
    environment = {"PATH": os.defpath, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    if os.environ.get("PYTHONPATH"):
        environment["PYTHONPATH"] = os.environ["PYTHONPATH"]
    try:
        done = subprocess.run(
            command,
            cwd=out,
            env=environment,
            capture_output=True,
            timeout=10 * seconds,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired as error:
        raise ConfigError(f"{path} was not imported: reading it takes more than {10 * seconds} s") from error
    if not (out / "content.json").is_file():
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"code {done.returncode}"
        raise ConfigError(
            f"{path} was not imported: its reader ended with {how}, at a limit of memory, time or size"
        )
