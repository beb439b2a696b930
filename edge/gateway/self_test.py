"""The self-test of a running station: golden frames, database, sensor, receivers and disk, each with its outcome."""

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from typing import Any, Final

from edge.acquisition import Acquisition, AcquisitionState
from edge.core.errors import StoreError
from edge.gateway.report import FreeSpace
from edge.gateway.station_loop import Parts
from edge.messaging.publisher import Publisher
from edge.store.database import quick_check

__all__ = ["GOLDEN_WITHIN_S", "STORE_WITHIN_S", "self_test"]

# The golden frames of a bundle take less than a second of turns in which nothing presses.
GOLDEN_WITHIN_S: Final = 10.0
STORE_WITHIN_S: Final = 5.0

Finding = tuple[bool, str]


def self_test(parts: Parts) -> Callable[[], Mapping[str, Any]]:
    """Asked on the loop's thread; the result is called on another one, while the loop scores the golden frames."""
    golden, where = parts.selection.golden.request(), parts.selection.inspector.bundle.where
    frames = len(parts.selection.inspector.bundle.golden)
    checks = {
        "sensor": _sensor(parts.acquisition),
        "receivers": _receivers(parts.publisher),
        "disk": _disk(parts.free_space),
    }

    def rest() -> Mapping[str, Any]:
        checks["store"] = _store(parts)
        checks["golden"] = _golden(golden, f"the {frames} golden frames of bundle {where}")
        return {
            "is_ok": all(is_ok for is_ok, _ in checks.values()),
            "parts": {part: {"is_ok": is_ok, "text": text} for part, (is_ok, text) in sorted(checks.items())},
        }

    return rest


def _golden(outcome: "Future[str | None]", what: str) -> Finding:
    try:
        fault = outcome.result(GOLDEN_WITHIN_S)
    except CancelledError:
        return False, f"{what} were not scored: the station ends"
    except TimeoutError:
        outcome.cancel()
        return False, f"{what} were not scored within {GOLDEN_WITHIN_S:g} s; lift the part and ask again"
    return fault is None, fault or f"{what} score as at the fit"


def _store(parts: Parts) -> Finding:
    end_ns = parts.clock.monotonic_ns() + round(STORE_WITHIN_S * 1e9)
    try:
        damage = quick_check(parts.store.path, lambda: parts.clock.monotonic_ns() > end_ns)
    except TimeoutError:
        return False, f"it was not read within {STORE_WITHIN_S:g} s; `gelgate db check` has no limit of time"
    except StoreError as error:
        return False, str(error)
    return damage is None, damage or "it is sound"


def _sensor(acquisition: Acquisition) -> Finding:
    status = acquisition.status
    if status.state is not AcquisitionState.STREAMING or status.identity is None:
        return False, status.fault or f"the sensor is {status.state.value}"
    return (
        True,
        f"{status.identity.product}, serial {status.identity.serial}, {status.fps:.1f} frames a second",
    )


def _receivers(publisher: Publisher) -> Finding:
    counters = publisher.counters()
    faults = [
        f"{name}: {fault}"
        for name, counter in counters.items()
        for fault in (*counter.faults, *([] if counter.is_up else [counter.last_error or "not yet tried"]))
    ]
    return not faults, "; ".join(faults) or f"{', '.join(counters)}: up"


def _disk(free_space: FreeSpace) -> Finding:
    low = free_space.check()
    free = "an unknown room" if free_space.bytes is None else f"{free_space.bytes / 1e6:.0f} MB"
    return low is None, low or f"{free} free"
