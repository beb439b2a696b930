"""The model card and the page about the backbone, written from the facts and the evaluation beside the trunks.

`python3 -m calibration.backbone.card FOLDER --page docs/backbone.md` writes both. Nothing is typed in by hand:
`tactile_resnet18.json` comes from the training run, `tactile_resnet18_evaluation.json` from the evaluation, and a
number that is in neither is not in the card.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from calibration.backbone.package import NAME
from edge.core.errors import ConfigError

__all__ = ["card", "main", "page", "write_card"]

_LIMITS = (
    "Trained on simulated presses alone: two measured sensors, mixed and varied. Real gels differ; fit and set the "
    "threshold on presses of your own sensor.",
    "It has never seen an optical picture. On pictures that are not touch it is a random network with habits.",
    "It looks past the sensor at the imprint, so frames of another kind of sensor do not reliably score far out "
    "(foreign_out: the share that scores above every sound held-out press). Tell a wrong sensor by other means.",
    "JPEG compression, motion blur and a gel rim were not drawn in training.",
    "The optical check on pictures of screws, each loss alone, other widths and int8-aware fine-tuning are untried.",
)


# Settings of a recipe that the verb takes as options.
_OPTIONS = ("steps", "pairs", "side", "seed", "max_rate", "high_resolution", "precision")


def write_card(folder: Path) -> Path:
    """Write `<name>.md` beside the facts; gives its path. Errors: ConfigError when the facts are missing or broken."""
    path = folder / f"{NAME}.md"
    path.write_text(_text(folder, card))
    return path


def page(folder: Path) -> str:
    """The documentation's page: how the weights are made again, then the card. Errors: as `write_card`."""
    return _text(folder, _page)


def _text(folder: Path, write: Callable[[dict[str, Any], dict[str, Any] | None], str]) -> str:
    facts_file = folder / f"{NAME}.json"
    try:
        facts = json.loads(facts_file.read_text())
        evaluation_file = folder / f"{NAME}_evaluation.json"
        evaluation = json.loads(evaluation_file.read_text()) if evaluation_file.is_file() else None
        return write(facts, evaluation)
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f"no model card from '{facts_file}': {error}; package the run again") from error


def _page(facts: dict[str, Any], evaluation: dict[str, Any] | None) -> str:
    title, rest = card(facts, evaluation).split("\n", 1)
    return "\n".join(
        [
            "<!-- Printed from the facts and the evaluation beside the weights by calibration.backbone.card. -->",
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
            *_commands(facts),
            f"python3 -m calibration.backbone.evaluation --out plugins/backbones random=random_resnet18 trained={NAME} "
            f"trained_int8={NAME}_int8 --real REAL_FRAMES",
            "python3 -m calibration.backbone.card plugins/backbones --page docs/backbone.md",
            "```",
            "",
            "Training goes on with `--resume` after an interruption, and a resumed run gives the same weights as one",
            "that was left alone on the same CPU. On a CPU that other programs use, keep to `--threads 1`.",
            "",
            f"## {title.removeprefix('# ')}",
            rest.replace("\n### ", "\n#### ").replace("\n## ", "\n### "),
        ]
    )


def card(facts: dict[str, Any], evaluation: dict[str, Any] | None) -> str:
    """The card as Markdown."""
    recipe, last = facts["recipe"], facts["last_entry"]
    lines = [
        f"# {facts['name']}",
        "",
        f"A {facts['topology']} up to {facts['taps'][-1]} (taps {', '.join(facts['taps'])}), trained by this project",
        "on simulated presses that are drawn while it learns; no picture is stored and none is downloaded.",
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
        *_evaluated(evaluation),
        "",
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


def _evaluated(evaluation: dict[str, Any] | None) -> list[str]:
    """One table per set of the evaluation: rows of backbone and detector, columns of measures with intervals."""
    if evaluation is None:
        return ["Not evaluated yet."]
    lines: list[str] = []
    for title, rows in evaluation["sets"].items():
        names = list(dict.fromkeys(name for row in rows for name in row["measures"]))
        body = [
            (row["backbone"], row["detector"], *(_interval(row["measures"].get(name)) for name in names))
            for row in rows
        ]
        lines += [f"### {title}", "", *_table(("backbone", "detector", *names), body), ""]
    return lines


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
        options = " ".join(f"--{name.replace('_', '-')} {run['recipe'][name]}" for name in _OPTIONS)
        start = f" --start RUN{number - 1}" if run["recipe"].get("start") else ""
        last = " --package plugins/backbones" if number == len(runs) else ""
        is_cut = run["steps"] < run["recipe"]["steps"]
        cut = f"  # interrupted after step {run['steps']}" if is_cut else ""
        lines.append(f"gelgate train-backbone RUN{number}{start} {options}{last}{cut}")
    return lines


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 0 when done, else the sentence and its exit code."""
    parser = argparse.ArgumentParser(prog="calibration.backbone.card", description="Write the model card.")
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
