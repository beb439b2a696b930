"""The gel's wear, as arithmetic: how many presses it took, how many it may take, and what that means."""

from dataclasses import dataclass
from typing import Literal

__all__ = ["GelRecord", "GelState"]

GelState = Literal["good", "due", "replace"]


@dataclass(frozen=True)
class GelRecord:
    """One gel on one sensor, as the ledger knows it.

    serial: of the sensor. presses: contacts so far. limit_presses: contacts allowed; warn_fraction of them makes the
    gel due. Times are wall-clock nanoseconds; `first_use_ns` and `last_use_ns` are None before the first press,
    `removed_ns` is None while the gel is mounted. wear_index: optical wear of the untouched gel, 0 as new and 1 where
    it should be replaced, None if never measured. note: what the person who mounted it wrote.
    """

    serial: str
    gel_id: str
    presses: int
    limit_presses: int
    warn_fraction: float
    installed_ns: int
    first_use_ns: int | None = None
    last_use_ns: int | None = None
    removed_ns: int | None = None
    wear_index: float | None = None
    note: str = ""

    def __post_init__(self) -> None:
        if not self.serial or not self.gel_id:
            raise ValueError(
                f"a gel has a sensor serial and an id, found {self.serial!r} and {self.gel_id!r}"
            )
        if self.presses < 0 or self.limit_presses < 1:
            raise ValueError(
                f"gel {self.gel_id}: presses >= 0 and limit >= 1 are expected, "
                f"found {self.presses} and {self.limit_presses}"
            )
        if not 0 < self.warn_fraction <= 1:
            raise ValueError(f"gel {self.gel_id}: warn_fraction lies in (0, 1], found {self.warn_fraction}")

    @property
    def state(self) -> GelState:
        """`replace` at the limit or when optically worn, `due` from the warning fraction on, else `good`."""
        if self.presses >= self.limit_presses or (self.wear_index or 0.0) >= 1.0:
            return "replace"
        return "due" if self.presses >= self.warn_fraction * self.limit_presses else "good"

    @property
    def remaining_presses(self) -> int:
        return max(0, self.limit_presses - self.presses)
