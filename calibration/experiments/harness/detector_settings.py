"""Which taps a method reads from a backbone, and what is changed where the backbone lacks those of the mode."""

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.core.detector import Detector, Mode
from edge.core.errors import ConfigError, FitError
from edge.model.onnx_validation import output_names

__all__ = ["overrides_for", "taps_of", "write_overrides"]


@lru_cache(maxsize=64)
def overrides_for(method: str, mode: Mode, backbone: str) -> dict[str, Any]:
    """Parameters that differ from the mode's, empty where the backbone gives the taps that the mode reads.

    The published InReaCh reads thirteen taps of a Wide-ResNet-50-2. With another backbone it reads its stages, on the
    grid of the middle one. Errors: ConfigError for an unknown method or backbone; FitError where nothing fits.
    """
    detector = registry.detector(method)
    wanted = set(detector.taps(detector.parameters(mode)))
    given = _find_taps(backbone, tuple(sorted(wanted)))
    if wanted <= set(given):
        return {}
    if not {"taps", "grid_tap"} <= set(vars(detector.parameters(mode))):
        raise FitError(
            f"{method} in {mode} mode reads {', '.join(sorted(wanted))}, the backbone '{backbone}' gives "
            f"{', '.join(given)}; export a trunk with these taps, or leave the method or the mode out"
        )
    return {"taps": tuple(given), "grid_tap": given[len(given) // 2]}


def write_overrides(overrides: Mapping[str, Any]) -> str:
    """Changed parameters as text for a row."""
    return "; ".join(
        f"{name} {', '.join(map(str, value)) if isinstance(value, tuple) else value}"
        for name, value in overrides.items()
    )


def _find_taps(backbone: str, wanted: tuple[str, ...]) -> list[str]:
    """The wanted taps if the backbone has them all, else those that it gives without being asked."""
    usual = open_trunk(backbone)
    given = output_names(usual.graph)
    if set(wanted) <= set(given):
        return given
    try:
        return output_names(open_trunk(backbone, wanted).graph)
    except (ConfigError, FitError):
        return given


def taps_of(methods: Iterable[str], modes: Iterable[Mode], backbone: str) -> tuple[str, ...]:
    """The taps that these methods read, sorted: they are extracted together. Errors: as `overrides_for`."""
    modes = tuple(modes)
    read: set[str] = set()
    for method in methods:
        for mode in modes:
            detector: Detector = registry.detector(method)
            read |= set(detector.taps(detector.parameters(mode, **overrides_for(method, mode, backbone))))
    return tuple(sorted(read))
