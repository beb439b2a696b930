"""Packages that only some verbs need: asked for at a verb's start, so that no work is done in vain."""

from functools import cache
from importlib.metadata import version
from importlib.util import find_spec

from edge.core.errors import ConfigError

__all__ = ["find_version", "is_installed", "needs", "where_to_get"]

# The package to import, by the extra of `pip install` that brings it.
_STUDIES = ("joblib", "pandas", "matplotlib", "jinja2", "scipy")
_PACKAGES = {
    "openvino": ("openvino",),
    "train": ("torch",),
    "studies": _STUDIES,
    "cluster": (*_STUDIES, "distributed"),
    "signing": ("cryptography",),
    "metrics": ("prometheus_client",),
    "parquet": ("pyarrow",),
    "oak": ("depthai",),
    "opcua": ("asyncua",),
    "validate": ("jsonschema",),
    "datamatrix": ("zxingcpp",),
    "docs": ("zensical",),
}


@cache
def find_version(package: str) -> str:
    """Find the version of an installed package, once: to read it takes longer than to judge a frame."""
    return version(package)


def is_installed(package: str) -> bool:
    """Say whether a package can be imported, without importing it."""
    try:
        return find_spec(package) is not None
    except ImportError:
        return False


def where_to_get(package: str) -> str:
    """Say how a package that an import did not find is installed."""
    extra = next((name for name, packages in _PACKAGES.items() if package in packages), None)
    return f"pip install 'gelgate[{extra}]'" if extra else f"pip install {package}, or install gelgate again"


def needs(extra: str, what: str) -> None:
    """Refuse `what`, a verb or a wish in the operator's words, where the extra's packages are not installed.

    Errors: ConfigError with the command that installs them.
    """
    missing = [package for package in _PACKAGES[extra] if not is_installed(package)]
    if missing:
        raise ConfigError(
            f"{what} needs {' and '.join(missing)}, not installed here; pip install 'gelgate[{extra}]'"
        )
