"""Pieces of three places with interruptions: the figures of docs/operations.md.

`python tests/bench/pieces.py [PIECES [SEED]]` makes 1,000 by default, half of them in a fixed order, and prints what
happened: kills before and after a write, writes that fail, commits that are reported as failed, pieces that are left,
wrong places, new gels, ids twice. It ends with 1 where a piece passed with a place missing, was lost or doubled.
Twenty seconds of one core.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from piece_world import NEVER, World


def main(pieces: int = 1000, seed: int = 0) -> int:
    """Play both orders, and print the sums."""
    sums: Counter[str] = Counter()
    for order in ("fixed", "free"):
        with tempfile.TemporaryDirectory() as folder:
            world = World(Path(folder) / "gelgate.db", seed, order)
            world.play(pieces // 2)
            sums.update(world.audit())
    print(f"{pieces} pieces")
    for name in sorted(sums.keys() - NEVER):
        print(f"  {name}: {sums[name]}")
    for name in NEVER:
        print(f"{name}: {sums[name]}")
    return int(any(sums[name] for name in NEVER))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
