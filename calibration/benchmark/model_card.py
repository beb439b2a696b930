"""The model card and the page about the backbone, written from the facts and the evaluation beside the trunks.

`python3 -m calibration.benchmark.model_card FOLDER --page docs/backbone.md` writes both, and
`gelgate evaluate-backbone` does with `--page`. Nothing is typed in by hand: `tactile_resnet18.json`
comes from the training run, `tactile_resnet18_evaluation.json` from the evaluation, `tactile_resnet18_trials.json` from
`calibration.training.ablations`, and a number that is in none of them is not in the card.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.benchmark.trial import FORMAT
from edge.core.errors import ConfigError
from plugins.backbones.tactile import tactile_resnet18

__all__ = ["TRIALS_FORMAT", "card", "evaluation_tables", "main", "page", "write_card"]

NAME = tactile_resnet18.name
TRIALS_FORMAT = 2
"""Of the file of trials; 1 held sentences and numbers without the runs they came from."""

_LIMITS = (
    "Trained on simulated presses alone: two measured sensors, mixed and varied. Real gels differ; fit and set the "
    "threshold on presses of your own sensor.",
    "It has learnt from parts that are held to a few tenths of a millimetre, and to tell what differs by less from "
    "damage. Where parts lie anywhere, as the balls of the real presses do, methods that compare place with place find "
    "little, and less the more it has learnt: PaDiM fitted to them passed the imprint of a thread. InReaCh, which does "
    "not, finds more; a fit of the others is refused unless told `--scattered`.",
    "Other widths, larger training frames and shallower damage were tried for 700 steps only, and one and a half times "
    "the width would not keep to 6 MB. Training that rounds as int8 does (`precision int8`) was tried for 600 steps.",
    "The int8 variant was measured on a processor with VNNI. On x86 without it sums would saturate; the gateway finds "
    "that out by trying and asks for wider ones, which cost what int8 gains: use the float variant there.",
    "It has never seen an optical picture. On pictures that are not touch it is a random network with habits.",
    "It looks past the sensor at the imprint, so frames of another kind of sensor do not reliably score far out. "
    "The gateway refuses them by their colours before it scores (`other_sensor`); whoever uses the trunk alone tells a "
    "wrong sensor by other means.",
    "A gel rim was not drawn in training, nor was motion blur: the trial `smeared` had it, gained nothing on presses "
    "that slide and lost on registered ones.",
)


# Settings of a recipe that the verb takes as options; a run made before one of them existed does not have it.
_OPTIONS = {
    "steps": "steps",
    "pairs": "pairs",
    "side": "side",
    "seed": "seed",
    "geometry": "geometry_weight",
    "pair": "pair_weight",
    "rank": "rank_weight",
    "window-mm": "window_mm",
    "finest-weight": "finest_weight",
    "distance": "distance",
    "max-rate": "max_rate",
    "high-resolution": "high_resolution",
    "precision": "precision",
}


@dataclass(frozen=True)
class _Known:
    """The three files, parsed; None where one is not there."""

    facts: dict[str, Any]
    evaluation: dict[str, Any] | None
    trials: dict[str, Any] | None


def write_card(folder: Path) -> Path:
    """Write `<name>.md` beside the facts; gives its path. Errors: ConfigError when the facts are missing or broken."""
    path = folder / f"{NAME}.md"
    path.write_text(_text(folder, _card))
    return path


def page(folder: Path) -> str:
    """The documentation's page: how the weights are made again, then the card. Errors: as `write_card`."""
    return _text(folder, _page)


def _text(folder: Path, write: Callable[["_Known"], str]) -> str:
    facts_file = folder / f"{NAME}.json"
    try:
        facts = json.loads(facts_file.read_text())
        return write(_Known(facts, _beside(folder, "evaluation"), _beside(folder, "trials")))
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f"no model card from '{facts_file}': {error}; package the run again") from error


def _beside(folder: Path, what: str) -> dict[str, Any] | None:
    file = folder / f"{NAME}_{what}.json"
    found: dict[str, Any] | None = json.loads(file.read_text()) if file.is_file() else None
    return found


def _card(known: _Known) -> str:
    return card(known.facts, known.evaluation, known.trials)


def _page(known: _Known) -> str:
    title, rest = _card(known).split("\n", 1)
    return "\n".join(
        [
            "<!-- Printed from facts and evaluation next to the weights by calibration.benchmark.model_card -->",
            "",
            "# The backbone made for touch",
            "",
            "Features of pictures are no features of touch, and no weights can be fetched where this product runs. So",
            "it brings its own: a small network that has learnt, on simulated presses, to read slopes and depth from",
            "the light, to give two presses of one part the same features, and to tell damage from the pose.",
            "",
            "Make it again, judge it, and write this page:",
            "",
            "```",
            *_commands(known.facts),
            _evaluation_command(known.evaluation),
            "```",
            "",
            "`REAL_TACTILE` and `SCREWS` are folders of pictures that are no part of the product; a table that needs",
            "one says so where it is not given. Any other trunk is compared as a further `NAME=TRUNK`.",
            "",
            "Training goes on with `--resume` after an interruption, and a resumed run gives the same weights as one",
            "that was left alone on the same CPU. On a CPU that other programs use, keep to `--threads 1`.",
            "",
            f"## {title.removeprefix('# ')}",
            rest.replace("\n### ", "\n#### ").replace("\n## ", "\n### "),
        ]
    )


def card(
    facts: dict[str, Any], evaluation: dict[str, Any] | None, trials: dict[str, Any] | None = None
) -> str:
    """The card as Markdown."""
    recipe, last = facts["recipe"], facts["last_entry"]
    lines = [
        f"# {facts['name']}",
        "",
        f"A {facts['topology']} up to {facts['taps'][-1]} (taps {', '.join(facts['taps'])}), trained by this project",
        "on simulated presses that are drawn while it learns; no picture is stored and none is downloaded.",
        "Licence: Apache-2.0, as the program; docs/licences.md says what the training saw.",
        "",
        "## Training",
        "",
        *_table(("setting", "value"), [(name, str(value)) for name, value in sorted(recipe.items())]),
        "",
        *_before(facts),
        f"{facts['trained_steps']} steps, {facts['pairs_seen']} pairs of frames in all. At the last step:",
        "",
        *_table(
            ("quantity", "value"),
            [
                (name, _number(value))
                for name, value in last.items()
                if name not in ("step", "frames_per_second")
            ],
        ),
        "",
        "`recall_fpr01_<stage>`: on pairs that training never draws, the share of damaged cells whose features differ",
        "more than 99 % of the undamaged ones do.",
        "",
        "## Variants",
        "",
        *_table(
            ("file", "bytes", *(f"error {tap}" for tap in facts["taps"]), "SHA-256"),
            [
                (
                    f"{name}.onnx",
                    str(v["bytes"]),
                    *(_number(v["relative_error"][t]) for t in facts["taps"]),
                    v["sha256"][:16],
                )
                for name, v in facts["variants"].items()
            ],
        ),
        "",
        "Error: norm of the difference to the float32 features over their norm, on simulated frames of their own.",
        "",
        "## Evaluation",
        "",
        *_evaluated(facts, evaluation),
        "",
        *_tried(facts, trials),
        "## Known limits",
        "",
        *(f"- {limit}" for limit in (*_LIMITS, *_scales(recipe))),
        "",
    ]
    return "\n".join(lines)


def _before(facts: dict[str, Any]) -> list[str]:
    """A table of the runs that this one began with."""
    runs = facts.get("before", [])
    if not runs:
        return []
    rows = [
        (
            str(number),
            str(run["steps"]),
            ", ".join(f"{k} {v}" for k, v in sorted(run["recipe"].items()) if v != ""),
        )
        for number, run in enumerate(runs, start=1)
    ]
    return [
        "It began with the weights of another run:",
        "",
        *_table(("run", "steps done", "settings"), rows),
        "",
    ]


def _scales(recipe: dict[str, Any]) -> list[str]:
    if "side" not in recipe:
        return []
    return [
        f"Regions of {recipe['side']} pixels a side at 0.063 mm per pixel and, in {recipe['high_resolution']:.0%} of "
        "the batches, at 0.015 to 0.045. Other scales are untried."
    ]


def _evaluated(facts: dict[str, Any], evaluation: dict[str, Any] | None) -> list[str]:
    """The tables, if they are of these weights: an evaluation of others lies there until the next one."""
    if evaluation is None or evaluation["format"] != FORMAT:
        return ["Not evaluated yet."]
    compared = [trunk["sha256"] for trunk in evaluation["trunks"].values()]
    if facts["variants"][NAME]["sha256"] not in compared:
        return ["Not evaluated yet."]
    return evaluation_tables(evaluation)


def evaluation_tables(evaluation: dict[str, Any]) -> list[str]:
    """Markdown lines: a table per set, rows of backbone and detector, columns of measures with intervals."""
    replicates, settings = evaluation["replicates"], evaluation["settings"]
    lines = [
        f"In brackets: 95 % intervals from {replicates} bootstrap replicates over presses, within each part. AU-PRO is "
        "integrated up to 1 % false positives.",
        "",
        "The detectors' settings:",
        "",
        *(f"- {method}: {_listed(chosen)}" for method, chosen in settings.items()),
        "",
    ]
    for of in evaluation["sets"].values():
        lines += [f"### {of['title']}", "", of["text"], "", *_rows(of), ""]
    return lines


def _rows(of: dict[str, Any]) -> list[str]:
    if "rows" not in of:
        return [f"Not measured: {of['missing']}."]
    names = list(dict.fromkeys(name for row in of["rows"] for name in row["measures"]))
    body = [
        (row["backbone"], row["detector"], *(_interval(row["measures"].get(name)) for name in names))
        for row in of["rows"]
    ]
    return [f"Trials: {', '.join(of['trials'])}.", "", *_table(("backbone", "detector", *names), body)]


# The parameters that say where a method reads and how much it keeps; the evaluation's file has them all.
_SHOWN = (
    "taps",
    "layers",
    "grid_tap",
    "channels",
    "dims",
    "rank",
    "neighbours",
    "block",
    "window_mm",
    "sigma",
)


def _listed(chosen: dict[str, Any]) -> str:
    return ", ".join(f"{name} {_short(chosen[name])}" for name in _SHOWN if chosen.get(name) is not None)


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "all"
    return _number(value)


def _tried(facts: dict[str, Any], trials: dict[str, Any] | None) -> list[str]:
    """The section on other settings, empty where nobody wrote any down."""
    if not trials or trials["format"] != TRIALS_FORMAT or not trials["rows"]:
        return []
    (first, title), *_ = trials["sets"].items()
    methods = list(trials["rows"][0]["measures"][first])
    body = []
    for row in trials["rows"]:
        found = row["measures"]
        numbers = [found[first][method]["aupro_fpr01"] for method in methods]
        for name in trials["sets"]:
            numbers += [
                sum(values[measure] for values in found[name].values()) / len(found[name])
                for measure in ("aupro_fpr01", "image_auroc")
            ]
        body.append((row["name"], _changes(facts, row), *(f"{number:.3f}" for number in numbers)))
    head = [f"{method}: {first}" for method in methods]
    head += [f"{measure}: {name}" for name in trials["sets"] for measure in ("AU-PRO", "AUROC")]
    return [
        "## What was tried",
        "",
        f"AU-PRO up to 1 % false alarms of each method on '{title}', then, set by set, the mean of the methods' AU-PRO",
        "and of their image AUROC. Settings are what differs from the run that ships.",
        "",
        *_table(("trial", "settings", *head), body),
        "",
    ]


def _changes(facts: dict[str, Any], row: dict[str, Any]) -> str:
    """How a run differs from the one that ships, in its settings and in what its note says."""
    shipped = facts["recipe"]
    changes = [f"{k} {v}" for k, v in row["recipe"].items() if v != shipped.get(k) and k != "start"]
    before = [f"begun with the weights of {row['before']} earlier steps"] if row["before"] else []
    return "; ".join(filter(None, (row["note"], *before, ", ".join(changes)))) or "what ships"


def _interval(measure: dict[str, Any] | None) -> str:
    if measure is None or measure["value"] is None:
        return "-"
    span = measure.get("over_images")
    return f"{measure['value']:.3f}" + (f" ({span[0]:.3f} to {span[1]:.3f})" if span else "")


def _number(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {' | '.join(row)} |" for row in rows)]


def _commands(facts: dict[str, Any]) -> list[str]:
    """One line per run that led to the weights; a run that was cut says after how many steps."""
    runs = [*facts.get("before", []), {"recipe": facts["recipe"], "steps": facts["recipe"]["steps"]}]
    lines = []
    for number, run in enumerate(runs, start=1):
        chosen = {option: run["recipe"].get(name) for option, name in _OPTIONS.items()}
        options = " ".join(f"--{option} {value}" for option, value in chosen.items() if value is not None)
        start = f" --start RUN{number - 1}" if run["recipe"].get("start") else ""
        last = " --package plugins/backbones" if number == len(runs) else ""
        is_cut = run["steps"] < run["recipe"]["steps"]
        cut = f"  # interrupted after step {run['steps']}" if is_cut else ""
        lines.append(f"gelgate train-backbone RUN{number}{start} {options}{last}{cut}")
    return lines


def _evaluation_command(evaluation: dict[str, Any] | None) -> str:
    """The call that compares the same trunks again; those that do not ship come from runs of their names."""
    shipped = {"trained": NAME, "trained_int8": f"{NAME}_int8"}
    names = list((evaluation or {}).get("trunks", {}))
    others = [name for name in names if name not in shipped and name != "random"]
    columns = [f"{name}={trunk}" for name, trunk in shipped.items()]
    columns += [f"{name}=RUN_{name}/{NAME}.onnx" for name in others]
    return (
        f"gelgate evaluate-backbone plugins/backbones {' '.join(columns)} --workers 2 "
        "--tactile REAL_TACTILE --screws SCREWS --page docs/backbone.md"
    )


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    parser = argparse.ArgumentParser(
        prog="calibration.benchmark.model_card", description="Write the model card."
    )
    parser.add_argument("folder", type=Path, help="where the facts lie")
    parser.add_argument("--page", type=Path, help="the documentation's page, written as well")
    given = parser.parse_args(words)
    try:
        write_card(given.folder)
        if given.page:
            given.page.write_text(page(given.folder))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
