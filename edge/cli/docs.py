"""`gelgate station docs`: the manual that comes with the installation, in the terminal and as a site with search.

The site has the same files: README.md is its first page, and its section Documentation is the navigation.
"""

import json
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from edge import extras
from edge.clock import SystemClock
from edge.core.errors import ConfigError, GelgateError
from edge.core.suggest import suggestion

__all__ = ["build_site", "docs"]

PORT = 8081

SITE = """\
[project]
site_name = "gelgate"
docs_dir = "pages"
site_dir = "site"
use_directory_urls = false
nav = [{navigation}]
theme.font = false
theme.palette = [
  {{ media = "(prefers-color-scheme: light)", scheme = "default" }},
  {{ media = "(prefers-color-scheme: dark)", scheme = "slate" }},
]
"""

# What the pages link to, besides each other.
_ROOMS = ("docs", "firmware_notes", "deploy")
_SUFFIXES = (".md", ".png", ".svg", ".webp", ".toml", ".json", ".jsonl", ".yaml", ".sh")
_OTHERS = ("Dockerfile", "CITATION.cff")
_EXAMPLE = "edge/service/example.toml"


def docs(
    page: Annotated[
        str, typer.Argument(help="A page's name, such as mqtt. Without it the pages are listed.")
    ] = "",
    site: Annotated[
        Path | None,
        typer.Option(
            "--site", help="Write the manual as a site with search into this folder; needs the extra docs."
        ),
    ] = None,
    is_served: Annotated[
        bool, typer.Option("--serve", help="Serve that site to a browser on this machine, until Ctrl-C.")
    ] = False,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="The port of --serve.")] = PORT,
) -> None:
    """List the pages of the manual, or print one.

    --site makes a site of it that needs no network. The page of a station links to it where `manual` names the
    folder."""
    pages = _pages()
    if not pages:
        raise ConfigError("this installation has no manual; install gelgate from its wheel")
    if site is not None or is_served:
        with nullcontext(str(site)) if site is not None else TemporaryDirectory() as parent:
            folder = Path(parent) if site is not None else Path(parent, "site")
            if is_served:
                _serve(folder, port)
            else:
                build_site(folder)
                typer.echo(
                    f"the manual is in {folder}; it begins with index.html; its search needs --serve or the page of a "
                    "station"
                )
    elif not page:
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
    pages = {
        room if path.stem == "README" else path.relative_to(root / room).with_suffix("").as_posix(): path
        for root in _roots()
        for room in ("docs", "firmware_notes")
        for path in (root / room).rglob("*.md")
    }
    return dict(sorted(pages.items()))


def _roots() -> list[Path]:
    """Where README.md and docs/ are: the source tree if there is one, else the installation."""
    tree = Path(__file__).parents[2]
    if (tree / "docs").is_dir():
        return [tree]
    try:
        files = distribution("gelgate").files or []
    except PackageNotFoundError:
        return []
    readme = [file for file in files if file.as_posix().endswith("share/doc/gelgate/README.md")]
    return [Path(str(file.locate())).resolve().parent for file in readme]


def build_site(folder: Path) -> None:
    """Write the manual as a site into a new folder, or over an older one. Errors: ConfigError, GelgateError."""
    extras.needs("docs", "a site of the manual")
    if folder.exists() and not (folder / "search.json").is_file():
        raise ConfigError(f"{folder} is there and holds no manual; choose a new folder")
    with TemporaryDirectory() as work:
        pages = Path(work, "pages")
        for name, source in _site_files(_roots()[0]):
            (pages / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, pages / name)
        (pages / _EXAMPLE).parent.mkdir(parents=True, exist_ok=True)
        (pages / _EXAMPLE).write_text((files("edge.service") / "example.toml").read_text(encoding="utf-8"))
        navigation = ", ".join(_navigation((pages / "README.md").read_text(encoding="utf-8")))
        Path(work, "zensical.toml").write_text(SITE.format(navigation=navigation), encoding="utf-8")
        words = [sys.executable, "-m", "zensical", "build", "--strict", "-f", "zensical.toml"]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
        if done.returncode:
            raise GelgateError(f"the site of the manual cannot be built:\n{done.stdout}{done.stderr}")
        (Path(work, "site") / "404.html").unlink(missing_ok=True)  # its links begin at the root of a server
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(Path(work, "site"), folder)


def _site_files(root: Path) -> Iterator[tuple[str, Path]]:
    """Every file of the site, by its name in the tree."""
    for path in sorted(
        [
            *root.glob("*.md"),
            root / "CITATION.cff",
            *(one for room in _ROOMS for one in (root / room).rglob("*")),
        ]
    ):
        if path.is_file() and (path.suffix in _SUFFIXES or path.name in _OTHERS):
            yield path.relative_to(root).as_posix(), path


def _navigation(readme: str) -> Iterator[str]:
    """The groups of README's section Documentation, as zensical's table of navigation."""
    yield '{ "gelgate" = "README.md" }'
    section = readme.partition("## Documentation")[2].partition("\n## ")[0]
    for title, body in re.findall(r"^- \*\*(.+?)\*\*:(.*?)(?=^- |\Z)", section, re.MULTILINE | re.DOTALL):
        pages = dict.fromkeys(re.findall(r"\]\(([^)#]+\.md)", body))
        yield f"{{ {json.dumps(title)} = {json.dumps(list(pages))} }}"


def _serve(folder: Path, port: int) -> None:
    """Write the site, and serve it to browsers on this machine until Ctrl-C. A port in use is refused before the
    site is written, which takes some seconds. Errors: as build_site."""
    from edge.page.manual import serve_manual

    with serve_manual(folder, port, SystemClock()):
        build_site(folder)
        typer.echo(f"http://127.0.0.1:{port}/  (Ctrl-C ends it)")
        threading.Event().wait()
