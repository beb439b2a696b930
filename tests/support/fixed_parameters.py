"""A detector whose settings are fixed, whatever its caller asks for."""

from typing import Any

__all__ = ["FixedParameters"]


class FixedParameters:
    """A detector that answers every request for parameters with one mode and some changes of it."""

    def __init__(self, detector: Any, mode: str, changes: dict[str, Any]) -> None:
        self._detector, self._mode, self._changes = detector, mode, changes

    def parameters(self, mode: str = "corrected") -> Any:
        return self._detector.parameters(self._mode, **self._changes)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._detector, name)
