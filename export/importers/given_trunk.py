"""Importers of files without backbone weights: the trunk is given, and its taps must be those of the training."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.fitting.features import trunk_grid
from calibration.fitting.trunks import Trunk
from edge.core.detector import Grid
from edge.core.errors import ConfigError, FitError
from edge.model.graph_cut import cut_trunk
from edge.model.onnx_validation import GraphRefused
from edge.model.session import open_session
from export.importers.contract import Settings

__all__ = ["Given", "cut_given_trunk"]


@dataclass(frozen=True)
class Given:
    """The trunk, cut after the taps that are read, and its grid on the inspected region."""

    trunk: Trunk
    grid: Grid


def cut_given_trunk(settings: Settings, path: Path, taps: Sequence[str], why: str) -> Given:
    """Cut the trunk at these taps. Errors: ConfigError where no trunk was given or it lacks a tap."""
    trunk = settings.require_trunk(path, why)
    try:
        graph = cut_trunk(trunk.graph, tuple(taps))
    except GraphRefused as error:
        raise ConfigError(f"the trunk '{trunk.id}' cannot be used: {error}") from error
    cut = Trunk(trunk.id, graph, trunk.facts)
    try:
        grid = trunk_grid(
            open_session(graph, 2, f"the trunk '{trunk.id}'"), taps, settings.frame, settings.pixels_per_mm
        )
    except FitError as error:
        raise ConfigError(f"{path}: {error}") from error
    return Given(cut, grid)
