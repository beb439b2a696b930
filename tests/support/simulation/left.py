"""`python -m simulation.left SEED FOLDER PZ0 PZ1`: prints all that the run of a seed leaves, so that two are compared.

The folder's name is in what people have done, and so in the ledger.
"""

import hashlib
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from simulation.schedule import Simulation
from simulation.surroundings import install_plugins


def tell_left(simulation: Simulation, folder: Path) -> Iterator[str]:
    """Give lines: events, what each broker got and retains, each row of the database, and the digest of each file."""
    run = simulation.run
    yield from (*run.events, *map(repr, run.schedule), f"{run.turns} turns", *run.faults)
    yield from map(repr, (*sorted(run.reached.items()), *sorted(run.counted.items())))
    for name, broker in simulation.world.brokers.items():
        yield from (f"{name} got {result!r}" for result in broker.results.items())
        yield from (f"{name} retains {message!r}" for message in sorted(broker.retained.items()))
    with closing(sqlite3.connect(folder / "disk/gelgate.db")) as database:
        tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
        for (table,) in tables.fetchall():
            yield from (f"{table} {row!r}" for row in database.execute(f'SELECT * FROM "{table}"'))
    for path in sorted((folder / "disk").rglob("*")):
        if path.is_file() and not path.name.startswith("gelgate.db"):
            yield f"{path.relative_to(folder)} {hashlib.sha256(path.read_bytes()).hexdigest()}"


def main() -> int:
    seed, made, *bundles = sys.argv[1:]
    folder = Path(made)
    with contextmanager(install_plugins)(folder / "plugins"):
        simulation = Simulation(int(seed), 0, [Path(path) for path in bundles], folder / "run")
        simulation.play()
    print("\n".join(tell_left(simulation, folder / "run")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
