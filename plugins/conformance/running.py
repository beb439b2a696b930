"""Running checks, and their two questions: is this true, and is that refused with the right error."""

from collections.abc import Callable, Iterable
from typing import TypeVar

__all__ = ["raises", "require", "run_all"]

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
