"""`gelgate new`: a plugin in a package of its own, which works and passes the checks of its kind as it is written.

A file here and its test become NAME.py and test_NAME.py in a folder gelgate-NAME; where they say `template` the new
name stands.
"""

import keyword
import re
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal

import typer

from edge import registry
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion

__all__ = ["new"]

GROUPS: Final[MappingProxyType[str, Literal["sinks", "devices", "detectors", "features"]]] = MappingProxyType(
    {"sink": "sinks", "device": "devices", "detector": "detectors", "feature": "features"}
)

# A longer one would break lines of the copy.
_LONGEST: Final = 30

PROJECT: Final = """\
[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "gelgate-{name}"
version = "0.1"
dependencies = ["gelgate"]

[project.entry-points."gelgate.{group}"]
{name} = "{name}:plugin"

[tool.setuptools]
py-modules = ["{name}"]
package-dir = {{ "" = "." }}

[tool.ruff]
line-length = 110
lint.select = ["E", "F", "W", "I", "UP", "B", "C4", "SIM", "RET", "PIE", "PT", "NPY", "RUF"]
lint.pycodestyle.max-line-length = 120
lint.isort.known-first-party = ["edge", "plugins"]
lint.isort.known-local-folder = ["{name}"]

[tool.mypy]
strict = true
"""


def new(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of {', '.join(GROUPS)}.")],
    name: Annotated[str, typer.Argument(help="Its name in the configuration, and of its module.")],
) -> None:
    """Write a sink, device, detector or feature to begin with.

    A package in a folder gelgate-NAME: code that works, a test that runs the published checks of its kind, and
    pyproject.toml. docs/plugins.md says what each kind does.
    """
    check_name(kind, name)
    # Not the module's own name: pytest would take the folder for the module where both can be imported.
    here, folder = Path(__file__).parent, Path(f"gelgate-{name}")
    try:
        folder.mkdir()
    except FileExistsError:
        raise ConfigError(f"{folder} is there already; choose another name, or remove it") from None
    for written, source in ((f"{name}.py", f"{kind}.py"), (f"test_{name}.py", f"test_{kind}.py")):
        text = (here / source).read_text(encoding="utf-8").replace(f"from .{kind} ", f"from {name} ")
        (folder / written).write_text(text.replace("template", name), encoding="utf-8")
    project = PROJECT.format(name=name, group=GROUPS[kind])
    (folder / "pyproject.toml").write_text(project, encoding="utf-8")
    python = shlex.quote(sys.executable)  # a plain pip may be that of another environment
    typer.echo(
        f"{kind} {name} written into {folder}; install it beside this gelgate, and try it:\n"
        f"  {python} -m pip install -e {folder}\n  {python} -m pytest {folder}"
    )


def check_name(kind: str, name: str) -> None:
    """Refuse what cannot be made. Errors: ConfigError."""
    if kind not in GROUPS:
        raise ConfigError(
            f"'{kind}' is no kind of plugin that `gelgate new` writes; {suggestion(kind, GROUPS)}"
        )
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name) or len(name) > _LONGEST:
        raise ConfigError(
            f"'{name}' cannot name a module; expected a lower-case letter, then letters, digits and _, at most "
            f"{_LONGEST}, and no word of Python, such as press_log"
        )
    if name in registry.names(GROUPS[kind]):
        raise ConfigError(f"there is a {kind} named '{name}' already; choose another name")
    if find_spec(name) is not None:
        raise ConfigError(
            f"'{name}' is the name of an installed module, which it would hide; choose another name"
        )
