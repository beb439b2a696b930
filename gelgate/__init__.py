"""gelgate for other programs: score pictures of presses, fit bundles, open a station; and the program `gelgate`.

What `__all__` names is public: it changes as semver.org says. All else may change in any version. `gelgate.interface`
has the examples. Nothing is imported before it is used.
"""

import gc
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from edge.core.errors import GelgateError
    from gelgate.interface import Bundle, Score, fit, load, open_station

__all__ = ["Bundle", "GelgateError", "Score", "fit", "load", "main", "open_station"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'gelgate' has no attribute '{name}'")
    from gelgate import interface

    return getattr(interface, name)


def main() -> NoReturn:
    """Run the command line. Ends with 3 where `edge` is another program's."""
    gc.disable()  # until the verb is loaded: modules stay to the end, and are a tenth of a start to look through
    # A service that is asked to reload while it is loaded, which takes a second, has read nothing yet.
    if sys.argv[1:2] == ["run"] and not os.isatty(0):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    # The program stands outside `edge`, to say so where another folder of that name hides the package.
    try:
        from edge.cli import main as run
    except KeyboardInterrupt:
        print("gelgate: interrupted", file=sys.stderr)
        sys.exit(130)
    except ImportError:
        import edge

        hiding, ours = (
            Path(next(iter(getattr(edge, "__path__", [edge.__file__])))),
            Path(__file__).parents[1],
        )
        if hiding.parent.resolve() == ours.resolve():
            raise
        print(
            f"gelgate: {hiding} hides gelgate's own package 'edge'; rename it, or take {hiding.parent} off PYTHONPATH",
            file=sys.stderr,
        )
        sys.exit(3)
    run()
