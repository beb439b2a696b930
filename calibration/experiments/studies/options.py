"""The arguments of `gelgate lab study`, in the order of its help; each verb leaves out those that it has no use for."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from edge.core.errors import ConfigError

if TYPE_CHECKING:
    from calibration.experiments.harness.study import Options

__all__ = ["StudyArguments", "parse_counts", "parse_fractions"]


def _hidden_default(text: str) -> Any:
    return typer.Option(help=text, show_default=False)


@dataclass(frozen=True)
class StudyArguments:
    """What the command line says."""

    dataset: Annotated[Path, typer.Argument(help="The folder of presses, nominal and defective.")]
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="Output folder: rows.jsonl and the report; new, or one to continue."
        ),
    ]
    part: Annotated[
        list[str] | None,
        _hidden_default("A part; may be given several times. Default: all of the dataset."),
    ] = None
    position: Annotated[
        str | None, _hidden_default("The reference position; default: each part's first by name.")
    ] = None
    target: Annotated[str | None, _hidden_default("The other position; default: the second by name.")] = None
    presses: Annotated[
        int,
        typer.Option(min=2, help="Nominal presses of the pool at most: 1280x720 takes memory and time."),
    ] = 40
    view: Annotated[
        list[str] | None,
        _hidden_default(
            "lr, hr_tiled, lr_tiled, hr_full or lr_full; may be given several times. Default: all."
        ),
    ] = None
    fraction: Annotated[
        float | None,
        _hidden_default(
            "Share of the pool that every method learns from, in percent. Default: the stable fraction of each, "
            "from the good-fraction rows in the output folder; in paper mode the paper's own."
        ),
    ] = None
    method: Annotated[
        list[str] | None,
        _hidden_default("A detector; may be given several times. Default: all but the baselines."),
    ] = None
    mode: Annotated[
        list[str] | None, _hidden_default("corrected or paper; may be given twice. Default: corrected.")
    ] = None
    backbone: Annotated[
        list[str] | None,
        _hidden_default(
            "An installed backbone, or a trunk .onnx file; may be given several times. Default: tactile_resnet18."
        ),
    ] = None
    split: Annotated[
        list[str] | None,
        _hidden_default(
            "How test presses are held out: press (one by one, as in the paper) or specimen (all presses of a piece "
            "together); may be given twice. Default: press."
        ),
    ] = None
    seeds: Annotated[
        int, typer.Option(min=1, max=1000, help="Repetitions, each with other training presses.")
    ] = 10
    fractions: Annotated[
        str, typer.Option(help="Shares of the pool in percent: FIRST:LAST:STEP, a list, or 'none'.")
    ] = "5:100:5"
    shots: Annotated[str, typer.Option(help="Numbers of presses, or 'none'.")] = "1,2,4,8,16,32"
    held_out: Annotated[int, typer.Option("--held-out", min=1, help="Nominal presses kept for the test.")] = (
        20
    )
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes on this machine.")] = 1
    dask: Annotated[str | None, _hidden_default("Address of a Dask scheduler, such as tcp://host:8786.")] = (
        None
    )
    cache: Annotated[
        Path | None,
        _hidden_default("Folder of extracted features; default: 'features' in the output folder."),
    ] = None

    def options(self) -> "Options":
        """Return what is asked of the study. Errors: ConfigError, as `Options`, and for an impossible fraction."""
        from calibration.experiments.harness.study import Options

        if self.fraction is not None and not 0 < self.fraction <= 100:
            raise ConfigError(
                f"--fraction is a percentage above 0 up to 100, such as 40, found {self.fraction:g}"
            )
        several = {"parts": self.part, "methods": self.method, "modes": self.mode}
        several |= {"backbones": self.backbone, "splits": self.split}
        given: dict[str, Any] = {name: tuple(words or ()) for name, words in several.items()}
        given |= {name: getattr(self, name) for name in ("position", "seeds", "held_out", "jobs", "dask")}
        share = None if self.fraction is None else self.fraction / 100
        return Options(self.dataset, self.output, self.cache, fraction=share, **given)


NONE = "none"


def parse_fractions(text: str) -> tuple[float, ...]:
    """Return shares in (0, 1] from percentages: `5:100:5`, `5,10,20`, or `none`. Errors: ConfigError."""
    if text.strip() == NONE:
        return ()
    try:
        percent = _range(text) if ":" in text else [float(word) for word in text.split(",")]
    except ValueError:
        percent = []
    if not percent or not all(0 < value <= 100 for value in percent):
        raise ConfigError(
            f"--fractions are percentages above 0 up to 100, such as 5:100:5 or 5,10,20, found '{text}'"
        )
    return tuple(sorted({round(value / 100, 6) for value in percent}))


def _range(text: str) -> list[float]:
    first, last, step = (float(word) for word in text.split(":"))
    if step <= 0 or first > last:
        raise ValueError(text)
    return [first + k * step for k in range(int((last - first) / step + 1e-9) + 1)]


def parse_counts(text: str, option: str) -> tuple[int, ...]:
    """Return whole numbers of at least 1: `1,2,4`, or `none`. Errors: ConfigError."""
    if text.strip() == NONE:
        return ()
    try:
        counts = sorted({int(word) for word in text.split(",")})
    except ValueError:
        counts = []
    if not counts or counts[0] < 1:
        raise ConfigError(f"{option} are whole numbers of at least 1, such as 1,2,4, found '{text}'")
    return tuple(counts)
