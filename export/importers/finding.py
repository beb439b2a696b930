"""The installed importers, and which of them takes a file."""

from edge import registry
from edge.core.errors import ConfigError
from export.importers.contract import Importer, Recognised
from plugins.reading.foreign import Foreign, describe

__all__ = ["importer_of", "importers"]


def importers() -> list[Importer]:
    """List the installed importers by name. Errors: ConfigError for an object that is not an importer."""
    return [_load(name) for name in registry.names("importers")]


def importer_of(file: Foreign) -> tuple[Importer, Recognised]:
    """The importer that recognises the file, and what it is.

    Errors: ConfigError with what the file holds where none does, or where several do.
    """
    known = importers()
    fitting = [(each, what) for each in known if (what := each.recognised(file)) is not None]
    if not fitting:
        raise ConfigError(
            f"{file.path} is a {file.form} that holds {describe(file.content)}; no importer knows it. Known are "
            f"{', '.join(each.name for each in known)}; weights of a backbone come in by `gelgate export backbone`"
        )
    if len(fitting) > 1:
        names = ", ".join(importer.name for importer, _ in fitting)
        raise ConfigError(
            f"{file.path} is recognised by several importers ({names}); name one with --importer"
        )
    return fitting[0]


def _load(name: str) -> Importer:
    importer = registry.importer(name)
    if not isinstance(importer, Importer):
        raise ConfigError(
            f"the importer '{name}' is a {type(importer).__name__} without recognised and imported; correct its package"
        )
    return importer
