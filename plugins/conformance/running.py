"""Running checks, and their two questions: is this true, and is that refused with the right error."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from edge.core.imaging.frames import CameraFrame

__all__ = ["collect", "raises", "require", "require_order", "run_all"]

CaseT = TypeVar("CaseT")


def require(is_so: bool, found: str) -> None:
    """Raise AssertionError with what was found, unless it is so."""
    if not is_so:
        raise AssertionError(found)


def raises(
    expected: type[Exception] | tuple[type[Exception], ...], what: str, call: Callable[[], object]
) -> None:
    """The call ends with this error, or one of these. Errors: AssertionError when it returns or ends otherwise."""
    kinds = expected if isinstance(expected, tuple) else (expected,)
    words = " or ".join(kind.__name__ for kind in kinds)
    try:
        result = call()
    except kinds:
        return
    except Exception as error:
        raise AssertionError(f"{what}: {type(error).__name__} ({error}), expected {words}") from error
    raise AssertionError(f"{what}: it returned {result!r:.80}, expected {words}")


def require_order(frames: Sequence[CameraFrame]) -> None:
    """Refuse frames whose sequence numbers do not rise, or whose times decrease. Errors: AssertionError."""
    numbers, times = [frame.sequence for frame in frames], [frame.timestamp_ns for frame in frames]
    require(numbers == sorted(set(numbers)), f"sequence numbers are {numbers}")
    require(times == sorted(times), f"times are {times}")


def collect(names: Mapping[str, Any], case: Any) -> tuple[Any, ...]:
    """Collect the checks among a module's names, in their order: functions `check_...` of one case of this kind."""
    checks = (value for name, value in names.items() if name.startswith("check_"))
    return tuple(check for check in checks if next(iter(check.__annotations__.values())) is case)


def run_all(name: str, checks: Iterable[Callable[[CaseT], None]], make: Callable[[], CaseT]) -> None:
    """Run every check on a new case. Errors: ExceptionGroup with each failure and its fact."""
    failures: list[Exception] = []
    facts = list(checks)
    for check in facts:
        try:
            check(make())
        except Exception as error:  # noqa: BLE001 - the author wants to see any error of the plugin
            error.add_note(f"{check.__name__}: {check.__doc__}")
            failures.append(error)
    if failures:
        raise ExceptionGroup(f"{name}: {len(failures)} of {len(facts)} checks failed", failures)
