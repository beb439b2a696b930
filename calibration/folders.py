"""Folders and files that are written: each file complete; a stamp says which dataset or recording a folder holds."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

from edge.core.errors import ConfigError, GelgateError, StoreError

__all__ = [
    "claim",
    "is_empty",
    "make_folder",
    "read_stamp",
    "require_folder",
    "write_atomically",
    "write_whole",
]

# Longer values are named, not printed.
_MOST_PRINTED = 40


def claim(
    folder: Path,
    name: str,
    stamp: Mapping[str, object],
    what: str,
    error: type[GelgateError],
    way_on: str = "choose another folder",
) -> None:
    """Begin a folder with its stamp, or check that the stamp is there; `complete` may differ. name: of its file.

    Errors: `error` for a folder that holds something else, or another of `what`; StoreError for the disk.
    """
    if is_empty(folder, f"{name}.part", error):
        try:
            write_whole(folder / name, (json.dumps(stamp, indent=1) + "\n").encode())
        except OSError as refused:
            raise StoreError(
                f"{what} {folder} cannot be started: {refused.strerror}; free some space, or choose another folder"
            ) from refused
        return
    stored_stamp, wanted = read_stamp(folder / name), json.loads(json.dumps(stamp))
    if stored_stamp is None:
        raise error(f"{folder} is not empty and holds no {what}; {way_on}")
    keys = [key for key in wanted if key != "complete" and stored_stamp.get(key) != wanted[key]]
    if keys:
        differences = ", ".join(_compare(key, stored_stamp.get(key), wanted[key]) for key in keys)
        raise error(f"{folder} holds another {what}: {differences}; {way_on}, or give the same settings")


def is_empty(folder: Path, rest: str, error: type[GelgateError]) -> bool:
    """Tell whether nothing is in a folder but the rest of a killed program. Errors: `error` for a file."""
    if folder.exists() and not folder.is_dir():
        raise error(f"{folder} is a file, a folder is expected; choose another name")
    return not folder.exists() or all(path.name == rest for path in folder.iterdir())


def read_stamp(path: Path) -> dict[str, object] | None:
    """Read a stamp, None where there is none."""
    try:
        stamp = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return stamp if isinstance(stamp, dict) else None


def _compare(key: str, found: object, wanted: object) -> str:
    if key == "sha256" or max(len(repr(found)), len(repr(wanted))) > _MOST_PRINTED:
        return "other settings" if key == "sha256" else f"other {key}"
    return f"{key} {found!r}, not {wanted!r}"


def write_whole(path: Path, content: bytes) -> None:
    """Write the complete file or none, after a power cut too; the rest of a killed program is overwritten."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def make_folder(folder: Path) -> None:
    """Make a folder for output. Errors: ConfigError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder} cannot be a folder: {error.strerror}; choose another place") from error


def require_folder(path: Path | None) -> None:
    """Check where a file is to be written. Errors: ConfigError for a folder, or a file in no existing folder."""
    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        raise ConfigError(f"'{path}' cannot be written; name a file in an existing folder")


def write_atomically(path: Path, content: bytes) -> None:
    """Write the complete file or none. Errors: GelgateError where the disk refuses."""
    try:
        write_whole(path, content)
    except OSError as error:
        raise GelgateError(f"'{path}' cannot be written: {error.strerror}; choose another path") from error
