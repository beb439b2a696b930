"""One stage of a comparison, and how far it differs: `export.parity` compares, `export.parity_page` shows."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from numpy.typing import NDArray

__all__ = ["ORDER_LEAST", "TOLERANCES", "Kind", "Stage", "StageResult"]

Array = NDArray[Any]

TOLERANCES: Mapping[str, float] = {
    "input": 1e-5,
    "tap": 1e-4,
    "descriptor": 1e-4,
    "distance": 1e-3,
    "map": 1e-3,
    "score": 1e-3,
}
"""Allowed difference by kind of stage, relative to the largest expected value. Both sides compute in float32: a trunk
sums some thousand products per value (measured: 1e-6 to 3e-5), a distance loses digits where it is small."""

ORDER_LEAST = 0.9995
"""The least rank correlation of the scores: 1.000 to three digits."""

Kind = Literal["input", "tap", "descriptor", "distance", "map", "score", "order"]


@dataclass(frozen=True)
class Stage:
    """One stage of both models for the same frames, frames first.

    expected: from the research model; found: from the bundle; any real dtype, equal shapes (n, ...). kind: decides the
    usual tolerance. tolerance: another one, relative to the largest expected value; for `order`, the least rank
    correlation.
    """

    name: str
    expected: Array
    found: Array
    kind: Kind = "tap"
    tolerance: float | None = None

    @property
    def allowed(self) -> float:
        if self.tolerance is not None:
            return self.tolerance
        return ORDER_LEAST if self.kind == "order" else TOLERANCES[self.kind]


@dataclass(frozen=True)
class StageResult:
    """How far one stage differs.

    difference: largest absolute difference over the largest expected value; for `order`, the rank correlation. at: the
    place of the largest difference, with the two values there. fault: why the stages cannot be compared, or empty.
    """

    name: str
    kind: Kind
    shape: tuple[int, ...]
    difference: float
    allowed: float
    at: tuple[int, ...] = ()
    expected: float = 0.0
    found: float = 0.0
    fault: str = ""

    @property
    def is_equal(self) -> bool:
        if self.fault:
            return False
        if self.kind == "order":
            return self.difference >= self.allowed
        return self.difference <= self.allowed

    def sentence(self) -> str:
        """The stage's result in words."""
        if self.fault:
            return f"stage '{self.name}' {self.fault}"
        if self.kind == "order":
            return (
                f"stage '{self.name}': the rank correlation of {self.shape[0]} scores is {self.difference:.4f}, at "
                f"least {self.allowed:g} is expected"
            )
        return (
            f"stage '{self.name}': largest difference {self.difference:.2g} of the largest value at {self.at} "
            f"(expected {self.expected:.6g}, found {self.found:.6g}), {self.allowed:g} is allowed"
        )
