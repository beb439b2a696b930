"""Training trials other than the run that ships, as a file that the model card prints.

`gelgate evaluate-backbone OUT shipped=... NAME=... --set SET ...` compares trunks, and

    python3 -m calibration.benchmark.ablations OUT/tactile_resnet18_evaluation.json FOLDER NAME=RUN ... --note NAME=TEXT

joins its rows with the settings of their runs into `FOLDER/tactile_resnet18_trials.json`:

{"format": 2, "sets": {set: title}, "rows": [{"name": ..., "note": what the recipe cannot say, "before": steps of runs
that it began with, "recipe": {...}, "measures": {set: {detector: {measure: mean over the set's trials}}}}]}.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.benchmark.model_card import TRIALS_FORMAT
from calibration.benchmark.trial import FORMAT
from calibration.training.checkpoint import load
from edge.core.errors import ConfigError, GelgateError
from plugins.backbones.tactile import tactile_resnet18

__all__ = ["joined", "main"]


def joined(
    evaluation: Mapping[str, Any], runs: Mapping[str, Path], notes: Mapping[str, str]
) -> dict[str, Any]:
    """The trials in the order of `runs`, whose names are trunks of the evaluation.

    Errors: ConfigError for an evaluation of another version, a name that it lacks, a note on no run, or a folder
    without a checkpoint.
    """
    if evaluation.get("format") != FORMAT:
        raise ConfigError(f"an evaluation of format {evaluation.get('format')}, not {FORMAT}; evaluate again")
    unknown = sorted({*runs, *notes} - (evaluation["trunks"].keys() & runs.keys()))
    if unknown:
        raise ConfigError(
            f"no run and trunk is named {', '.join(unknown)}; the evaluation has {', '.join(evaluation['trunks'])}"
        )
    sets = {name: of for name, of in evaluation["sets"].items() if "rows" in of}
    return {
        "format": TRIALS_FORMAT,
        "sets": {name: of["title"] for name, of in sets.items()},
        "rows": [_row(name, run, notes.get(name, ""), sets) for name, run in runs.items()],
    }


def _row(name: str, run: Path, note: str, sets: Mapping[str, Any]) -> dict[str, Any]:
    trained = load(run)
    return {
        "name": name,
        "note": note,
        "before": sum(earlier["steps"] for earlier in trained.before),
        "recipe": json.loads(trained.recipe.to_json()),
        "measures": {
            key: {
                row["detector"]: {measure: found["value"] for measure, found in row["measures"].items()}
                for row in of["rows"]
                if row["backbone"] == name
            }
            for key, of in sets.items()
        },
    }


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    parser = argparse.ArgumentParser(
        prog="calibration.benchmark.ablations", description="Write the table of training trials."
    )
    parser.add_argument("evaluation", type=Path, help="the file written by evaluate-backbone")
    parser.add_argument("folder", type=Path, help="output folder")
    parser.add_argument(
        "runs", nargs="+", metavar="NAME=RUN", help="a trunk of the evaluation and its run's folder"
    )
    parser.add_argument(
        "--note",
        action="append",
        default=[],
        metavar="NAME=TEXT",
        help="a difference that no setting describes",
    )
    given = parser.parse_args(words)
    try:
        runs = {name: Path(run) for name, _, run in (word.partition("=") for word in given.runs)}
        notes = {name: text for name, _, text in (word.partition("=") for word in given.note)}
        found = joined(json.loads(given.evaluation.read_text()), runs, notes)
        path = given.folder / f"{tactile_resnet18.name}_trials.json"
        path.write_text(json.dumps(found, indent=1) + "\n")
    except (GelgateError, OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
