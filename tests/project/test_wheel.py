"""The built wheel holds every package and every data file of the tree."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("edge", "plugins", "calibration", "export")


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The file names inside a wheel built from the tree as git knows it."""
    out = tmp_path_factory.mktemp("wheel")
    source = tmp_path_factory.mktemp("source")
    tracked = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name in filter(None, tracked.stdout.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    with zipfile.ZipFile(next(out.glob("gelgate-*.whl"))) as archive:
        return set(archive.namelist())


def tracked_files(pattern: str) -> set[str]:
    return {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob(pattern)
        if "__pycache__" not in path.parts
    }


@pytest.mark.parametrize("pattern", ["*.py", "*.toml", "*.onnx", "*.json", "*.md", "py.typed"])
def test_every_file_of_the_packages_is_in_the_wheel(wheel_names: set[str], pattern: str) -> None:
    """A module or a data file that works from the tree also works when installed."""
    assert tracked_files(pattern) <= wheel_names


def test_every_folder_with_modules_is_a_package(wheel_names: set[str]) -> None:
    """A folder without `__init__.py` would import from the tree and be missing from the wheel."""
    folders = {str(Path(name).parent) for name in tracked_files("*.py")}

    assert {f"{folder}/__init__.py" for folder in folders} <= tracked_files("__init__.py")


def test_tests_and_docs_stay_out(wheel_names: set[str]) -> None:
    """Only the four packages and the metadata are shipped."""
    assert {name.split("/")[0] for name in wheel_names if ".dist-info" not in name} == set(PACKAGES)
