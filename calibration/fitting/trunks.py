"""Where a trunk comes from at fit: an installed backbone by its name, or an ONNX file."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edge import registry
from edge.core.errors import ConfigError, FitError
from edge.model.graph_cut import cut_trunk
from edge.model.onnx_validation import GraphRefused, metadata, output_names

__all__ = ["DEFAULT_BACKBONE", "Trunk", "every_cut", "open_trunk"]

DEFAULT_BACKBONE = "tactile_lite0"
"""The better one of those that ship on real touch; docs/backbone.md."""

# Longer entries are a trunk's tiles or another tool's data, not a fact for the manifest.
MOST_METADATA = 500


@dataclass(frozen=True)
class Trunk:
    """A trunk to fit on."""

    id: str
    """The backbone's name, or the file's."""
    graph: bytes
    facts: dict[str, Any] = field(default_factory=dict)
    """What the manifest records of its weights."""

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.graph).hexdigest()


def open_trunk(name: str, taps: Sequence[str] = ()) -> Trunk:
    """The trunk of an installed backbone, or of a path ending in `.onnx`, no deeper than these taps.

    taps: those that the detector reads; layers after the last of them are cut off. A backbone is asked for them only if
    its usual trunk lacks one, so that parts with the same depth share one file. Errors: ConfigError for an
    unknown name, FitError for a file that is not there.
    """
    whole = _whole(name, taps)
    try:
        graph = cut_trunk(whole.graph, taps)
    except GraphRefused as error:
        raise FitError(f"the trunk '{name}' cannot be used: {error}") from error
    return (
        whole
        if graph is whole.graph
        else Trunk(whole.id, graph, {**whole.facts, "cut_after": output_names(graph)[-1]})
    )


def every_cut(name: str, taps: Sequence[str] = ()) -> list[Trunk]:
    """The trunk with these taps, cut after each of its outputs: the same weights, whichever detectors read it.

    Errors: as `open_trunk`.
    """
    whole = _whole(name, taps)
    return [Trunk(whole.id, cut_trunk(whole.graph, (tap,)), whole.facts) for tap in output_names(whole.graph)]


def _whole(name: str, taps: Sequence[str]) -> Trunk:
    from edge.core.plugins import HasFacts  # at use: the command line imports this module for its help

    if name.endswith(".onnx") or "/" in name:
        try:
            graph = Path(name).read_bytes()
        except OSError as error:
            raise FitError(
                f"the trunk {name} cannot be read: {error.strerror}; make it with `gelgate export backbone`, or name "
                f"an installed backbone ({_list_known()})"
            ) from error
        return Trunk(Path(name).stem, graph, {**_metadata(graph), "file": Path(name).name})
    if name not in registry.names("backbones"):
        raise ConfigError(
            f"no backbone is named '{name}'; known: {_list_known()}, or a path to a trunk .onnx file"
        )
    backbone = registry.backbone(name)
    facts = dict(backbone.facts()) if isinstance(backbone, HasFacts) else {}
    usual = backbone.trunk()
    if set(taps) <= set(output_names(usual)):
        return Trunk(name, usual, facts)
    return Trunk(name, backbone.trunk(tuple(taps)), {**facts, "taps": list(taps)})


def _metadata(graph: bytes) -> dict[str, str]:
    """Read what the file says of itself, such as its weights and their licence; nothing where it is not a graph."""
    try:
        return {key: value for key, value in metadata(graph).items() if len(value) <= MOST_METADATA}
    except GraphRefused:  # refused where it is opened, with the sentence for that
        return {}


def _list_known() -> str:
    return ", ".join(registry.names("backbones")) or "none installed"
