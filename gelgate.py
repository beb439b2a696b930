"""The program `gelgate`. It stands outside `edge`, to say so where another folder of that name hides the package."""

import sys
from pathlib import Path
from typing import NoReturn

__all__ = ["main"]


def main() -> NoReturn:
    """Run the command line. Ends with 3 where `edge` is another program's."""
    try:
        from edge.cli import main as run
    except ImportError:
        import edge

        found, ours = Path(next(iter(getattr(edge, "__path__", [edge.__file__])))), Path(__file__).parent
        if found.parent.resolve() == ours.resolve():
            raise
        print(
            f"gelgate: {found} hides gelgate's own package 'edge'; rename it, or take {found.parent} off PYTHONPATH",
            file=sys.stderr,
        )
        sys.exit(3)
    run()


if __name__ == "__main__":
    main()
