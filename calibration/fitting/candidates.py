"""The methods and backbones between which a fit chooses, from the words of its command line."""

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.fitting.trunks import AUTO, DEFAULT_BACKBONE, OTHER_BACKBONES
from edge.core.errors import ConfigError

__all__ = ["DEFAULT_METHOD", "OTHER_METHODS", "Candidates"]

DEFAULT_METHOD = "padim"

OTHER_METHODS = ("patchcore",)
"""With the default method those of `--method auto`; docs/detectors.md says why no others."""


@dataclass(frozen=True)
class Candidates:
    """Names of methods, and names or files of trunks; the first of each is the usual one."""

    methods: Sequence[str]
    trunks: Sequence[str]

    @classmethod
    def of(cls, method: str, backbone: str) -> "Candidates":
        """method, backbone: a name, or `auto`."""
        methods = (DEFAULT_METHOD, *OTHER_METHODS) if method == AUTO else (method,)
        trunks = (DEFAULT_BACKBONE, *OTHER_BACKBONES) if backbone == AUTO else (backbone,)
        return cls(methods, trunks)

    @property
    def are_several(self) -> bool:
        return len(self.methods) > 1 or len(self.trunks) > 1

    def check(self, mode: str, settings: Sequence[str], threshold: float | None) -> None:
        """Refuses what is said of one method where several are candidates. Errors: ConfigError."""
        if len(self.methods) == 1:
            return
        named = f"name one with --method: {' or '.join(self.methods)}"
        if mode == "paper":
            raise ConfigError(
                f"--method auto compares methods in the mode corrected, and the published ones with nothing; {named}"
            )
        if settings:
            raise ConfigError(
                f"--set {settings[0]} is a parameter of one method, and --method auto chooses between "
                f"{len(self.methods)}; {named}, or leave --set out"
            )
        if threshold is not None:
            raise ConfigError(
                f"--threshold {threshold:g} is a score of one method, and --method auto chooses between "
                f"{len(self.methods)} whose scores have other units; {named}, or leave --threshold out"
            )
