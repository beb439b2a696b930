"""Backbones compared on real presses with small edits, as `gelgate lab evaluate-backbone` does on simulated ones.

`python tests/bench/real_touch_backbones.py FOLDER [NAME=TRUNK]...` prints the table and, with --rows FILE, writes all
of it as JSON. FOLDER holds real tactile frames, which are not part of the product.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))

from real_touch import SENSORS, real_touch_sets

from calibration.experiments.backbones.evaluation import (
    RANDOM,
    evaluate,
    evaluation_tables,
    random_trunk,
)
from calibration.experiments.harness.study import methods_to_compare
from calibration.fitting.trunks import open_trunk


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("folder", type=Path)
    words.add_argument("trunks", nargs="*", default=["trained=tactile_resnet18"], metavar="NAME=TRUNK")
    words.add_argument("--set", choices=SENSORS, default="real-touch")
    words.add_argument("--workers", type=int, default=1)
    words.add_argument("--rows", type=Path)
    given = words.parse_args()
    pairs = (word.partition("=") for word in given.trunks)
    graphs = {name: open_trunk(trunk or name).graph for name, _, trunk in pairs} | {RANDOM: random_trunk()}
    sets = real_touch_sets(given.folder, [given.set])
    found = evaluate(graphs, sets, methods_to_compare(), workers=given.workers)
    print(evaluation_tables(found))
    if given.rows:
        given.rows.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
