"""The arguments of `gelgate lab tradeoff`, in the order of its help."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibration.experiments.tradeoff.pick import Limits
    from calibration.experiments.tradeoff.plan import RunSettings

__all__ = ["TradeoffArguments"]


@dataclass(frozen=True)
class TradeoffArguments:
    """What the command line says."""

    dataset: Annotated[
        Path, typer.Argument(help="the folder of presses, good ones and defective ones with masks")
    ]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="the folder for rows.jsonl and tradeoff.html")
    ] = Path("tradeoff")
    part: Annotated[str | None, typer.Option(help="the part; optional for a dataset of one part")] = None
    position: Annotated[str | None, typer.Option(help="the position; optional for one position")] = None
    method: Annotated[
        list[str] | None, typer.Option(help="a detector, again for more; by default every installed one")
    ] = None
    backbone: Annotated[
        list[str] | None,
        typer.Option(
            help="an installed backbone or a trunk .onnx file, the first varied in every axis, again for more"
        ),
    ] = None
    within: Annotated[str | None, typer.Option(help="choose a point: most time of a press, such as 20ms")] = (
        None
    )
    under: Annotated[str | None, typer.Option(help="choose a point: largest bank, such as 8MB")] = None
    presses: Annotated[int | None, typer.Option(help="choose a point: most nominal presses", min=1)] = None
    point: Annotated[str | None, typer.Option(help="make only the bundle of the point of this name")] = None
    bundle: Annotated[
        Path | None,
        typer.Option(help="where the chosen bundle is written, a folder or a name ending in .zip"),
    ] = None
    check: Annotated[
        Path | None, typer.Option(help="rows.jsonl of an earlier run: fail where this one is worse")
    ] = None
    picture: Annotated[Path | None, typer.Option(help="also draw the rows as an SVG file of this name")] = (
        None
    )
    rounds: Annotated[int, typer.Option(help="rounds of timing", min=7)] = 25
    minutes: Annotated[float, typer.Option(help="after this many no new round of timing begins", min=0)] = (
        12.0
    )
    bootstrap: Annotated[int, typer.Option(help="bootstrap replicates per accuracy interval", min=20)] = 200
    seed: Annotated[int, typer.Option(help="fixes every random choice", min=0)] = 0
    threads: Annotated[int, typer.Option(help="threads of the runtime", min=1, max=64)] = 2
    overwrite: Annotated[
        bool, typer.Option(help="measure again although the folder has rows; replace the bundle")
    ] = False

    def settings(self) -> "RunSettings":
        """Return what the run depends on."""
        from calibration.experiments.tradeoff.plan import RunSettings

        named = {name: getattr(self, name) for name in ("seed", "threads", "rounds", "minutes")}
        return RunSettings(self.dataset, self.part, self.position, replicates=self.bootstrap, **named)

    def limits(self) -> "Limits":
        """Return what the chosen point may cost. Errors: ConfigError."""
        from calibration.experiments.tradeoff.pick import Limits, size, time_ms

        time, bank = self.within and time_ms(self.within), self.under and size(self.under)
        return Limits(time or None, bank or None, self.presses)
