"""`gelgate station install-service`: the systemd unit and the udev rule of a station."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer

from edge.core.errors import ConfigError, GelgateError

__all__ = ["install_service"]

# The names of the files in the package, and where the system looks for them.
_PLACES: Final = {
    "60-gelgate.rules": "etc/udev/rules.d/60-gelgate.rules",
    "gelgate.service": "etc/systemd/system/gelgate.service",
}
# The program and the configuration as the shipped unit names them.
_PROGRAM: Final = "/opt/gelgate/bin/gelgate"
_CONFIG: Final = "/etc/gelgate/gelgate.toml"

_BEFORE: Final = (
    "getent passwd gelgate >/dev/null || useradd --system --user-group --groups video gelgate",
)  # fmt: skip
_AFTER: Final = (
    "udevadm control --reload",
    "udevadm trigger --subsystem-match=usb --subsystem-match=video4linux --subsystem-match=hidraw",
    "systemctl daemon-reload",
)
_START: Final = "systemctl enable --now gelgate"

# What ProtectHome and PrivateTmp of the unit hide from the program.
_HIDDEN: Final = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")


def install_service(
    is_printed: Annotated[
        bool, typer.Option("--print", help="Print a shell script that does the same, and change nothing.")
    ] = False,
    config: Annotated[Path, typer.Option("--config", "-c", help="The station's TOML file.")] = Path(_CONFIG),
    root: Annotated[Path, typer.Option(help="Write below this folder, such as a mounted image.")] = Path("/"),
    is_removed: Annotated[
        bool, typer.Option("--remove", help="Stop the service and remove both files; data stays.")
    ] = False,
) -> None:
    """Install the systemd unit and the udev rule.

    The commands that activate them are printed. The unit starts the program that runs this command. Writing to /etc
    needs root; with --print nothing is written.
    """
    if is_removed:
        _remove(root, config, is_printed=is_printed)
        return
    _refuse_hidden(config)
    texts = {root / place: _text(name, config) for name, place in _PLACES.items()}
    if is_printed:
        typer.echo("\n".join(_script(texts, config)))
        return
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        typer.echo(f"written: {path}")
    typer.echo("next, as root:")
    for command in (*_BEFORE, *_AFTER, f"{_START}    # when {config.absolute()} exists"):
        typer.echo(f"  {command}")


def _refuse_hidden(config: Path) -> None:
    """Refuse places that the unit hides from the program. Errors: ConfigError."""
    used = [Path(sys.prefix), Path(sys.base_prefix), Path(__file__).parents[2], config.absolute()]
    hidden = [path for path in used for place in _HIDDEN if path.resolve().is_relative_to(place)]
    if hidden:
        raise ConfigError(
            f"the service needs {hidden[0]}, which its sandbox hides (ProtectHome, PrivateTmp); install gelgate "
            "in /opt/gelgate with a Python of the system: /usr/bin/python3 -m venv /opt/gelgate; "
            f"/opt/gelgate/bin/pip install <wheel or source folder>; the configuration belongs at {_CONFIG}; then "
            f"{_PROGRAM} station install-service"
        )


def _remove(root: Path, config: Path, *, is_printed: bool) -> None:
    """Remove the service. Errors: GelgateError where a command fails."""
    files = [root / place for place in _PLACES.values()]
    commands = [f"rm -fv '{path}'" for path in files]
    if root == Path("/"):
        commands = [f"! test -e '{files[-1]}' || systemctl disable --now gelgate", *commands, *_AFTER]
    if is_printed:
        typer.echo("\n".join(["#!/bin/sh", "set -e", *commands]))
        return
    if subprocess.run(["sh", "-ec", "\n".join(commands)], check=False).returncode != 0:
        raise GelgateError("the service is not completely removed, see above; run it again as root")
    typer.echo(
        f"left as they are: /var/lib/gelgate (the database and the files next to it), {config.parent} (configuration, "
        f"bundles), the program in {sys.prefix}, the user gelgate"
    )


def _text(name: str, config: Path) -> str:
    """A shipped file with the paths of this installation."""
    text = (Path(__file__).parents[1] / "service" / name).read_text(encoding="utf-8")
    program = Path(sys.executable).parent / "gelgate"
    return text.replace(_PROGRAM, str(program)).replace(_CONFIG, str(config.absolute()))


def _script(texts: dict[Path, str], config: Path) -> Iterator[str]:
    yield "#!/bin/sh\n# Sets gelgate up as a service; run it as root: gelgate station install-service --print | sudo sh"
    yield "set -e"
    yield from _BEFORE
    for path, text in texts.items():
        yield f"mkdir -p '{path.parent}'\ncat > '{path}' <<'END_OF_FILE'\n{text}END_OF_FILE"
    yield from _AFTER
    yield f'echo "when {config.absolute()} exists: {_START}"'
