"""Follow the first ten minutes of CONTRIBUTING.md to the letter, in a new clone and environment, and print the seconds.

python .ci/first_plugin.py sink feature detector
"""

import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 600


def read_commands(page: str) -> list[str]:
    """Return the commands of the page's first block, without what is said beside them."""
    block = re.findall(r"^```\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)[0]
    return [line.partition("#")[0].strip() for line in block.splitlines()]


def follow(kinds: Sequence[str]) -> int:
    """Run the commands for each kind, the committed state cloned; return 1 where one fails or they take too long."""
    environment = {name: value for name, value in os.environ.items() if name not in ("VENV", "MAKEFLAGS")}
    start = time.monotonic()
    with TemporaryDirectory() as folder:
        subprocess.run(["git", "clone", "--quiet", ROOT, folder], check=True)
        subprocess.run(["git", "checkout", "--quiet", "-B", "main"], cwd=folder, check=True)
        for kind in kinds:
            for command in read_commands((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")):
                line, before = command.replace("sink", kind), time.monotonic()
                done = subprocess.run(
                    line, shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False
                )
                print(f"{time.monotonic() - before:6.1f} s  {line}", flush=True)
                if done.returncode:
                    print(done.stdout[-4000:] + done.stderr[-4000:])
                    return 1
    took_s = time.monotonic() - start
    print(f"{took_s:6.1f} s for {', '.join(kinds)}; {LIMIT_S} are allowed for the first one")
    return int(took_s > LIMIT_S * len(kinds))


if __name__ == "__main__":
    sys.exit(follow(sys.argv[1:] or ["sink"]))
