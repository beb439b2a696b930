"""What a change of part costs the station between two presses, with bundles of the default method and trunk.

Budget: 100 ms from the request to the first press that the new bundle can judge, the record on the disk included. The
golden frames follow, one in each turn in which nothing presses.
"""

import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import pytest
from station import press_recording, station_config, variant
from stepped_station import SteppedStation

pytestmark = pytest.mark.bench

GELGATE = Path(sys.executable).parent / "gelgate"
ROUNDS, PARTS = 50, 4


def fitted(folder: Path) -> Path:
    """Copies of one bundle for several parts, in a folder."""
    nominal = press_recording(folder / "nominal", 40)
    words = [GELGATE, "fit", nominal, "-o", folder / "made", "--part", "part0"]
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
    for number in range(PARTS):
        variant(folder / "made", folder / "bundles" / f"part{number}", part=f"part{number}")
    return folder / "bundles"


def test_switching_parts(tmp_path: Path) -> None:
    """Every part in turn; the median and the longest."""
    bundles, recording = fitted(tmp_path), press_recording(tmp_path / "presses", 1)
    config = station_config(tmp_path / "station", recording, f'bundle_folder = "{bundles}"')
    times_ms, golden_ms = [], []
    with SteppedStation(config) as station:
        station.play_until(lambda: station.loop.session is not None)
        for number in range(ROUNDS):
            start = time.perf_counter()
            station.ask("select_part", part=f"part{(number + 1) % PARTS}")
            times_ms.append((time.perf_counter() - start) * 1e3)
            start = time.perf_counter()
            station.loop.step(None)
            golden_ms.append((time.perf_counter() - start) * 1e3)
        opened = [one.inspector.scorer for one in station.parts.selection.bundles.bundles.values()]
        trunks = {id(scorer._trunk) for scorer in opened}

    print(f"\n{PARTS} parts, {len(trunks)} trunk in memory; {ROUNDS} switches:")
    print(f"median {median(times_ms):.1f} ms, longest {max(times_ms):.1f} ms (budget 100 ms)")
    print(f"one golden frame after it: median {median(golden_ms):.1f} ms, longest {max(golden_ms):.1f} ms")
