"""The command line: one command `gelgate`, its verbs found through the entry points `gelgate.commands`.

A verb's module imports only typer at the top and everything heavy inside its function, so help stays instant.

Exit codes: 0 done · 1 the work failed while running · 2 bad command line · 3 bad configuration, bundle, recording
or dataset · 4 device or broker not available · 5 verdicts or verification failed · 130 interrupted.
"""

import sys
from typing import NoReturn

import typer

from edge import registry
from edge.core import errors

__all__ = ["EXIT_CODES", "build", "main"]

EXIT_CODES: tuple[tuple[type[errors.GelgateError], int], ...] = (
    (errors.ConfigError, 3),
    (errors.BundleError, 3),
    (errors.RecordingError, 3),
    (errors.DatasetError, 3),
    (errors.DeviceError, 4),
    (errors.SinkError, 4),
    (errors.GelgateError, 1),
)


def build() -> typer.Typer:
    """The application with every registered verb: a function becomes a command, a `Typer` becomes a group."""
    app = typer.Typer(
        name="gelgate",
        help="Touch inspection at the edge: score GelSight Mini presses, publish verdicts, count gel wear.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    # Without a callback a single registered verb would lose its name.
    app.callback()(lambda: None)
    for name in registry.names("commands"):
        verb = registry.load("commands", name)
        if isinstance(verb, typer.Typer):
            app.add_typer(verb, name=name)
        else:
            app.command(name)(verb)
    return app


def main() -> NoReturn:
    """Run the command line; every refusal is one sentence on stderr and a documented exit code."""
    try:
        build()()
    except errors.GelgateError as error:
        print(f"gelgate: {error}", file=sys.stderr)
        sys.exit(next(code for kind, code in EXIT_CODES if isinstance(error, kind)))
    except KeyboardInterrupt:
        print("gelgate: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)
