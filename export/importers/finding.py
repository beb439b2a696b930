"""The installed importers, and which of them takes a file."""

from edge import registry
from edge.core.errors import ConfigError
from export.importers.contract import Importer, Recognised
from export.reading.foreign import Foreign, described

__all__ = ["importer_of", "importers"]


def importers() -> list[Importer]:
    """Every installed importer, by name. Errors: ConfigError for an object that is none."""
    return [_checked(name) for name in registry.names("importers")]


def importer_of(file: Foreign) -> tuple[Importer, Recognised]:
    """The importer that recognises the file, and what it is.

    Errors: ConfigError with what the file holds where none does, or where several do.
    """
    known = importers()
    found = [(one, what) for one in known if (what := one.recognised(file)) is not None]
    if not found:
        raise ConfigError(
            f"{file.path} is a {file.form} that holds {described(file.content)}; no importer knows it. Known are "
            f"{', '.join(one.name for one in known)}; weights of a backbone come in by `gelgate export backbone`"
        )
    if len(found) > 1:
        names = ", ".join(one.name for one, _ in found)
        raise ConfigError(
            f"{file.path} is recognised by several importers ({names}); name one with --importer"
        )
    return found[0]


def _checked(name: str) -> Importer:
    found = registry.importer(name)
    if not isinstance(found, Importer):
        raise ConfigError(
            f"the importer '{name}' is a {type(found).__name__} without recognised and imported; correct its package"
        )
    return found
