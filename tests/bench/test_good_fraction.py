"""Where the time of the good-fraction study goes, in processor seconds: features, fit, scoring, measures.

Run with one thread: `OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 pytest tests/bench/test_good_fraction.py -m bench -s`.
GELGATE_BENCH_DATASET names a dataset in the paper's layout, such as that of `gelgate lab simulate paper`, and
GELGATE_BENCH_PART its part; otherwise made pictures are used, as many as PZ3 has. Budget: the complete study of one
part, four methods with twenty fractions and ten seeds, in 15 minutes on two cores.
"""

import os
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from study_cells import quiet

from calibration.studies.good_fraction_study import FRACTIONS, study_good_fraction
from calibration.studies.study import Options

pytestmark = pytest.mark.bench

MEASURED = (0.05, 0.25, 0.5, 0.75, 1.0)
SEEDS, CORES, BUDGET_MINUTES = 10, 2, 15
STAGES = ("cpu_fit_s", "cpu_score_s", "cpu_measure_s")


def frames(n: int) -> np.ndarray:
    """Smooth pictures that differ a little from press to press, uint8 (n, 224, 224, 3)."""
    rng = np.random.default_rng(0)
    each = rng.integers(60, 200, (14, 14, 3)) + rng.normal(0, 6, (n, 14, 14, 3))
    large = np.stack(
        [cv2.resize(p.astype(np.float32), (224, 224), interpolation=cv2.INTER_CUBIC) for p in each]
    )
    rgb: np.ndarray = np.clip(large + rng.normal(0, 1.5, large.shape), 0, 255).astype(np.uint8)
    return rgb


def made_dataset(root: Path) -> Path:
    """130 nominal and 12 defective presses of PZ3, each defect a bright square."""
    for k, picture in enumerate(frames(142)):
        full = np.full((240, 320, 3), 128, np.uint8)
        full[8:232, 48:272] = picture
        home, mask = root / "PZ3" / "pos1", np.zeros((240, 320), np.uint8)
        if k >= 130:
            home /= "fault"
            mask[100:120, 100 + 5 * (k - 130) :][:, :20] = 255
            full[mask > 0] += 40
            (home / "mask_320x240").mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(home / "mask_320x240" / f"PZ3_pos1_s{k:03d}_p01.png"), mask)
        (home / "rgb_320x240").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(home / "rgb_320x240" / f"PZ3_pos1_s{k:03d}_p01.png"), full[..., ::-1])
    return root


def test_where_the_time_of_a_study_goes(tmp_path: Path) -> None:
    """Prints processor seconds per cell by method and stage, and what they are for all 800 cells of a part."""
    given = os.environ.get("GELGATE_BENCH_DATASET")
    dataset = Path(given) if given else made_dataset(tmp_path / "data")
    part = os.environ.get("GELGATE_BENCH_PART", "PZ3")
    asked = Options(dataset=dataset, output=tmp_path, parts=(part,), seeds=1, show=quiet)
    start = time.process_time()
    rows = study_good_fraction(asked, fractions=MEASURED, shots=()).read()
    spent = time.process_time() - start
    scored = [row for row in rows if "error" not in row]
    assert len(scored) == len(asked.methods) * len(MEASURED)

    total = 0.0
    print(
        f"\n{part}, pool of {scored[0]['pool']}; processor seconds per cell, mean over {len(FRACTIONS)} fractions"
    )
    for method in asked.methods:
        own = sorted((row for row in scored if row["method"] == method), key=lambda row: row["fraction"])
        means = [float(np.mean(np.interp(FRACTIONS, MEASURED, [row[s] for row in own]))) for s in STAGES]
        total += sum(means) * len(FRACTIONS) * SEEDS
        print(f"  {method:8}" + "".join(f" {s[4:-2]} {m:6.3f}" for s, m in zip(STAGES, means, strict=True)))
    other = spent - sum(row[s] for row in scored for s in STAGES)
    cells = len(asked.methods) * len(FRACTIONS) * SEEDS
    print(f"  features, masks, rows: {other:.1f} s in all for {len(scored)} cells")
    print(
        f"  {cells} cells: {total:.0f} processor seconds, {60 * CORES * cells / total:.0f} cells a minute on {CORES} "
        f"cores, {total / 60 / CORES:.1f} minutes (budget {BUDGET_MINUTES})"
    )
