"""The page about the backbone, docs/backbone.md, printed from the files next to the trunks.

`make docs` writes it, and `gelgate evaluate-backbone --page` does after a new evaluation. `tactile_resnet18.json` comes
from the training run, `tactile_resnet18_evaluation.json` from the evaluation; `tactile_resnet18_trials.json` has what
was tried, as it was measured with version 0.2.0. The text is `calibration/benchmark/page.md.jinja`. The same three
files of `tactile_lite0` are about the trunk that `calibration.training.joined_trunk` makes; its text is
`touch.md.jinja`.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, TemplateError

from calibration.benchmark.trial import FORMAT
from calibration.training.train_config import TrainConfig
from edge.core.errors import ConfigError
from edge.core.imaging.known_profiles import MINI_LR_MM_PER_PX
from plugins.backbones.tactile import tactile_resnet18
from plugins.backbones.tactile_lite0 import tactile_lite0

__all__ = ["NAME", "TRIALS_FORMAT", "card", "evaluation_tables", "page"]

NAME = tactile_resnet18.name
TRIALS_FORMAT = 2
"""Of the trials file; format 1 held text and numbers without their runs."""

# The parameters for what a method reads and how much it keeps; the evaluation file has all of them.
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


def page(folder: Path) -> str:
    """The page about the weights in a folder. Errors: ConfigError when the facts are missing or invalid."""
    facts_file = folder / f"{NAME}.json"
    try:
        facts = json.loads(facts_file.read_text(encoding="utf-8"))
        return card(facts, _beside(folder, "evaluation"), _beside(folder, "trials"), _touch(folder))
    except (OSError, ValueError, KeyError, TemplateError) as error:
        raise ConfigError(f"no model card from '{facts_file}': {error}; package the run again") from error


def _touch(folder: Path) -> dict[str, Any] | None:
    """Facts, evaluation and trials of the trunk for real touch; None where a folder is a run of the other."""
    file = folder / f"{tactile_lite0.name}.json"
    if not file.is_file():
        return None
    return {
        "facts": json.loads(file.read_text(encoding="utf-8")),
        "evaluation": _beside(folder, "evaluation", tactile_lite0.name),
        "trials": _beside(folder, "trials", tactile_lite0.name),
    }


def _beside(folder: Path, what: str, name: str = NAME) -> dict[str, Any] | None:
    file = folder / f"{name}_{what}.json"
    found: dict[str, Any] | None = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None
    return found


def card(
    facts: dict[str, Any],
    evaluation: dict[str, Any] | None,
    trials: dict[str, Any] | None = None,
    touch: dict[str, Any] | None = None,
) -> str:
    """The page as Markdown. An evaluation or trials file of other weights or another format is omitted.

    touch: facts, evaluation and trials of the trunk for real touch.
    """
    template = _environment(facts["recipe"]).get_template("page.md.jinja")
    return template.render(
        facts=facts,
        touch=touch,
        evaluation=evaluation if _is_of(facts, evaluation) else None,
        trials=trials if trials and trials["format"] == TRIALS_FORMAT and trials["rows"] else None,
        commands=[*_training_commands(facts), _evaluation_command(evaluation)],
        meanings={name: field.description for name, field in TrainConfig.model_fields.items()},
        mm_per_px=MINI_LR_MM_PER_PX,
    )


def evaluation_tables(evaluation: dict[str, Any]) -> str:
    """Markdown: a table per set, rows of backbone and detector, columns of measures with intervals."""
    return _environment({}).get_template("evaluation.md.jinja").render(evaluation=evaluation)


def _environment(recipe: Mapping[str, Any]) -> Environment:
    """The templates and their filters. recipe: of the run that a trial differs from."""
    found = Environment(
        loader=PackageLoader("calibration.benchmark", ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters |= {
        "words": _words,
        "changes": lambda row: _changes(recipe, row),
        "columns": _columns,
        "interval": _interval,
        "listed": _listed,
        "mean": _mean,
        "mean_of": _mean_of,
        "number": _number,
    }
    return found


def _is_of(facts: Mapping[str, Any], evaluation: Mapping[str, Any] | None) -> bool:
    """Whether an evaluation compared these weights, not earlier ones."""
    if evaluation is None or evaluation["format"] != FORMAT:
        return False
    compared = [trunk["sha256"] for trunk in evaluation["trunks"].values()]
    return facts["variants"][NAME]["sha256"] in compared


def _columns(measures: Iterable[Mapping[str, Any]]) -> list[str]:
    """Every measure that a row has, in the order of their first row."""
    return list(dict.fromkeys(name for row in measures for name in row))


def _listed(chosen: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {_short(chosen[name])}" for name in _SHOWN if chosen.get(name) is not None)


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " and ".join(map(str, value)) or "all"
    return _number(value)


def _changes(recipe: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """How a trial differs from the run that ships: its settings and its note."""
    changes = [f"{k} {_words(v)}" for k, v in row["recipe"].items() if v != recipe.get(k) and k != "start"]
    before = [f"started from the weights of {row['before']} earlier steps"] if row["before"] else []
    return "; ".join(filter(None, (row["note"], *before, ", ".join(changes)))) or "what ships"


def _words(value: float | str | Sequence[str]) -> str:
    """A setting's value; a list as its words."""
    return ", ".join(value) if isinstance(value, list | tuple) else str(value)


def _interval(measure: Mapping[str, Any] | None) -> str:
    if measure is None or measure["value"] is None:
        return "-"
    span = measure.get("over_images")
    return f"{measure['value']:.3f}" + (f" ({span[0]:.3f} to {span[1]:.3f})" if span else "")


def _mean(methods: Mapping[str, Mapping[str, float]], measure: str) -> str:
    return f"{sum(values[measure] for values in methods.values()) / len(methods):.3f}"


def _mean_of(rows: Sequence[Mapping[str, Any]], measure: str, trial: str = "") -> str:
    """The mean of a measure over rows, of one trial or of all."""
    values = [row["trials"][trial][measure] if trial else row["measures"][measure]["value"] for row in rows]
    return f"{sum(values) / len(values):.3f}"


def _number(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _training_commands(facts: Mapping[str, Any]) -> list[str]:
    """One line per run that led to the weights; an interrupted run says after how many steps."""
    runs = [*facts.get("before", []), {"recipe": facts["recipe"], "steps": facts["recipe"]["steps"]}]
    shipped = json.loads(TrainConfig.shipped().to_json())
    lines = []
    for number, run in enumerate(runs, start=1):
        changes = [
            f" --set {k}={v}" for k, v in sorted(run["recipe"].items()) if k != "start" and v != shipped[k]
        ]
        start = f" --start RUN{number - 1}" if run["recipe"].get("start") else ""
        last = " --package plugins/backbones" if number == len(runs) else ""
        is_cut = run["steps"] < run["recipe"]["steps"]
        cut = f"  # interrupted after step {run['steps']}" if is_cut else ""
        lines.append(f"gelgate train-backbone RUN{number}{start}{''.join(changes)}{last}{cut}")
    return lines


def _evaluation_command(evaluation: Mapping[str, Any] | None) -> str:
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
