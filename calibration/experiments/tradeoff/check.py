"""Compares a run with an earlier one: what has become worse by more than the noise."""

from collections.abc import Iterator, Sequence
from typing import Final

from calibration.experiments.tradeoff.accuracy import MEASURES
from calibration.experiments.tradeoff.machine import is_same_machine
from calibration.experiments.tradeoff.rows import Row
from edge.core.errors import ConfigError

__all__ = ["check"]

ACCURACY_NOISE: Final = 0.005
"""Presses and seeds are the same, so what remains is arithmetic: the difference that a packed bank may have as well."""

TIME_NOISE: Final = 0.05
"""A ratio is worse when its interval lies above the earlier one by more than this share of it."""

SIZE_NOISE: Final = 0.01
"""Share by which a bank may grow: packing rounds."""

MEMORY_NOISE: Final = 0.10


def check(before: Sequence[Row], after: Sequence[Row]) -> tuple[list[str], list[str]]:
    """The losses, a sentence each with the point and the figure, and remarks on what was not compared.

    Errors: ConfigError where the runs did not see the same presses with the same seed.
    """
    for what in ("dataset_sha256", "seed"):
        if before[0][what] != after[0][what]:
            raise ConfigError(
                f"the earlier rows have {what} {before[0][what]}, these have {after[0][what]}: runs on other presses "
                "cannot be compared; measure both on one dataset with one seed"
            )
    is_same = is_same_machine(before[0]["machine"], after[0]["machine"])
    remarks = [] if is_same else ["times and memory are not compared: the earlier run was on another machine"]
    found = {row["key"]: row for row in after}
    losses = [loss for row in before for loss in _losses(row, found.get(row["key"]), is_same)]
    return losses, remarks


def _losses(before: Row, after: Row | None, is_same_machine: bool) -> Iterator[str]:
    key = before["key"]
    if after is None:
        yield f"{key}: the point is missing, it was measured before"
        return
    for name, label in MEASURES.items():
        old, new = (row["accuracy"][name]["value"] for row in (before, after))
        if old is not None and (new is None or new < old - ACCURACY_NOISE):
            yield f"{key}: {label} is {'undefined' if new is None else f'{new:.4f}'}, it was {old:.4f}"
    if after["bank_bytes"] > before["bank_bytes"] * (1 + SIZE_NOISE):
        yield f"{key}: the bank has {after['bank_bytes']} bytes, it had {before['bank_bytes']}"
    if not is_same_machine:
        return
    was, now = (row["ratio"] for row in (before, after))
    if now["low"] > was["high"] * (1 + TIME_NOISE):
        yield (
            f"{key}: a press takes {now['median']:.3f} times the bare trunk ({now['low']:.3f} to {now['high']:.3f}), "
            f"it took {was['median']:.3f} ({was['low']:.3f} to {was['high']:.3f})"
        )
    most, least = after["peak_memory_bytes"], before["peak_memory_bytes"]
    if most and least and most > least * (1 + MEMORY_NOISE):
        yield f"{key}: the peak memory is {most / 1e6:.0f} MB, it was {least / 1e6:.0f} MB"
