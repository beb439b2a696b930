"""A gateway process whose disk is full from the first recorded press on, until it has said that it halts.

Run as a program: `gateway_on_a_full_disk.py CONFIG`; the configuration's sink is `jsonl` in `out/`. The disk is full in
that no file may grow beyond what a few messages take: a press with its heatmap does not fit. Prints what was seen, as
JSON.
"""

import json
import resource
import sqlite3
import sys
import threading
import time
from pathlib import Path

from edge.clock import SystemClock
from edge.config import load_config
from edge.gateway.gateway import Gateway
from edge.gateway.recorder import PressReport
from edge.store.outbox import Outbox

FREE = resource.RLIM_INFINITY
# More than what a halt says, less than the heatmap of one press (some 60 kB).
ROOM_BYTES = 12_000
# Only what never comes is waited for so long.
PATIENCE_S = 120.0


def limit(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, FREE))


def said(folder: Path, word: str) -> bool:
    log = folder / "out" / "messages.jsonl"
    return log.is_file() and word in log.read_text(errors="replace")


def counted(folder: Path) -> int:
    connection = sqlite3.connect(f"file:{folder / 'gelgate.db'}?mode=ro", uri=True)
    (presses,) = connection.execute("SELECT count(*) FROM presses").fetchone()
    connection.close()
    return int(presses)


def await_delivery(database: Path) -> None:
    """Until the sink has what was said before, on a busy machine too: only what comes after finds no room."""
    deadline = time.monotonic() + PATIENCE_S
    with Outbox(database) as outbox:
        while outbox.status().rows and time.monotonic() < deadline:
            time.sleep(0.01)


def make_room_when_halted(folder: Path, seen: dict[str, object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not (said(folder, '"state":"halted"') and said(folder, '"alarm":"store"')):
        if time.monotonic() > deadline:
            break
        time.sleep(0.05)
    else:
        seen["recorded_while_halted"] = counted(folder)
    limit(FREE)


def main(config: Path) -> None:
    seen: dict[str, object] = {}
    folder = config.parent
    watcher = threading.Thread(target=make_room_when_halted, args=(folder, seen))

    def on_press(report: PressReport) -> None:
        if report.gel.presses == 1:
            await_delivery(loaded.store.path)
            limit((folder / "out" / "messages.jsonl").stat().st_size + ROOM_BYTES)
            watcher.start()

    loaded = load_config(config)
    with Gateway.open(loaded, SystemClock(), on_press) as gateway:
        summary = gateway.run(threading.Event())
    if watcher.ident is not None:
        watcher.join()
    print(json.dumps({**seen, "presses": summary.presses}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
