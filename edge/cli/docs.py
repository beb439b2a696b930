"""`gelgate station docs`: the manual that comes with the installation."""

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Annotated

import typer

from edge.core.errors import ConfigError
from edge.core.suggest import suggestion

__all__ = ["docs"]


def docs(
    page: Annotated[
        str, typer.Argument(help="A page's name, such as mqtt. Without it the pages are listed.")
    ] = "",
) -> None:
    """List the pages of the manual, or print one."""
    pages = _pages()
    if not pages:
        raise ConfigError("this installation has no manual; install gelgate from its wheel")
    if not page:
        for name, path in pages.items():
            lines = path.read_text(encoding="utf-8").splitlines()
            title = next((line for line in lines if line.startswith("# ")), "")
            typer.echo(f"{name:44} {title.removeprefix('# ')}")
    elif page not in pages:
        raise ConfigError(f"no page is named '{page}'; {suggestion(page, pages)}")
    else:
        typer.echo(pages[page].read_text(encoding="utf-8"), nl=False)


def _pages() -> Mapping[str, Path]:
    """Every page by its name without `.md`, from the source tree if there is one, else from the installation."""
    tree = Path(__file__).parents[2]
    roots = [tree] if (tree / "docs").is_dir() else _installed()
    pages = {
        path.relative_to(root / room).with_suffix("").as_posix(): path
        for root in roots
        for room in ("docs", "firmware_notes")
        for path in (root / room).rglob("*.md")
    }
    return dict(sorted(pages.items()))


def _installed() -> list[Path]:
    try:
        files = distribution("gelgate").files or []
    except PackageNotFoundError:
        return []
    readme = [file for file in files if file.as_posix().endswith("share/doc/gelgate/README.md")]
    return [Path(str(file.locate())).resolve().parent for file in readme]
