"""The raw scores of a graph whose outputs are normalised, as anomalib's exports are.

    output = (raw - threshold) / spread + 1/2, limited to 0..1          label = output > limit

The limits give most nominal presses the score 0, so a gateway takes the raw values, and the threshold is stated on
their scale. Ref: anomalib.post_processing.PostProcessor._normalize (2.7.0).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64
from export.onnx_values import rename

__all__ = ["SUFFIX", "Normalisation", "constants", "raw_scores"]

SUFFIX = "_normalised"
MOST_STEPS = 12
"""Nodes between an output and its normalisation: two choices, limits and a copy are usual."""


@dataclass(frozen=True)
class Normalisation:
    """How one output is made of the value `raw`."""

    output: str
    raw: str
    threshold: float
    spread: float
    limit: float | None
    """The output above which the graph's own label is anomalous; None where it has no label."""

    @property
    def words(self) -> str:
        """The formula, for the manifest."""
        return f"({self.output} - {self.threshold:.7g}) / {self.spread:.7g} + 0.5, limited to 0..1"

    @property
    def own_threshold(self) -> float | None:
        """The raw score above which the graph's own label is anomalous."""
        return None if self.limit is None else self.threshold + (self.limit - 0.5) * self.spread

    def apply(self, raw: NDArray[Any]) -> F64:
        """Normalise raw values as the graph does."""
        return np.clip((raw.astype(np.float64) - self.threshold) / self.spread + 0.5, 0, 1)


def raw_scores(model: Any, labels: Mapping[str, str]) -> tuple[Any, dict[str, Normalisation]]:
    """A copy of the model with raw outputs in place of the normalised ones, and how those were made.

    labels: output to the name of its label. The normalised outputs stay, with `_normalised` behind their names. Without
    any normalisation the model is given as it is.
    """
    normalised = {
        name: normalisation
        for name, label in labels.items()
        if (normalisation := _normalisation(model, name, label))
    }
    if not normalised:
        return model, {}
    changed = type(model)()
    changed.CopyFrom(model)
    kept = {output.name: output for output in model.graph.output}
    rename(changed, {name: name + SUFFIX for name in normalised})
    rename(changed, {normalisation.raw: name for name, normalisation in normalised.items()})
    changed.graph.output.extend(kept[name] for name in normalised)
    return changed, normalised


def constants(model: Any) -> dict[str, NDArray[Any]]:
    """The stored tensors of a graph by name, those of Constant nodes included."""
    from onnx import numpy_helper

    stored = {tensor.name: tensor for tensor in model.graph.initializer}
    for node in model.graph.node:
        if node.op_type == "Constant" and node.attribute:
            stored[node.output[0]] = node.attribute[0].t
    return {name: numpy_helper.to_array(tensor) for name, tensor in stored.items()}


def _normalisation(model: Any, output: str, label: str) -> Normalisation | None:
    made = {name: node for node in model.graph.node for name in node.output}
    stored = constants(model)
    at: list[str] = [output]
    for _ in range(MOST_STEPS):
        if not at:
            return None
        node = made.get(at.pop(0))
        if node is None:
            continue
        if node.op_type in ("Where", "Clip", "Min", "Max", "Identity"):
            at += [name for name in _passed(node, stored) if name in made]
        elif (steps := _steps(node, made, stored)) is not None:
            return Normalisation(output, *steps, _number(made.get(label), "Greater", stored))
    return None


def _passed(node: Any, stored: Mapping[str, NDArray[Any]]) -> list[str]:
    """The inputs that a node may give on; a choice that is fixed gives one."""
    names = [name for name in node.input if name not in stored]
    if node.op_type == "Where" and node.input[0] in stored:
        return [node.input[1 if stored[node.input[0]].all() else 2]]
    return names


def _steps(
    node: Any, made: Mapping[str, Any], stored: Mapping[str, NDArray[Any]]
) -> tuple[str, float, float] | None:
    """(raw value, threshold, spread) where the node adds a half to a difference that was divided."""
    divided = made.get(node.input[0]) if node.input else None
    lowered = made.get(divided.input[0]) if divided is not None and divided.input else None
    half = _number(node, "Add", stored)
    spread, threshold = _number(divided, "Div", stored), _number(lowered, "Sub", stored)
    if half != 0.5 or threshold is None or not spread or lowered is None or lowered.input[0] not in made:
        return None
    return str(lowered.input[0]), threshold, spread


def _number(node: Any, kind: str, stored: Mapping[str, NDArray[Any]]) -> float | None:
    """The one number that a node of this kind has as its second input."""
    if node is None or node.op_type != kind or len(node.input) != 2:
        return None
    value = stored.get(node.input[1])
    is_number = value is not None and value.size == 1 and bool(np.isfinite(value).all())
    return float(value.reshape(-1)[0]) if value is not None and is_number else None
