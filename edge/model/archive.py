"""A bundle's files on disk: a folder or a zip, checked while reading.

Files are read into memory once and never mapped. A mapped file that is replaced while a gateway runs changes its scores
or kills it (SIGBUS), and a bank has at most some megabytes.
"""

import os
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Protocol

from edge.core.errors import BundleCorrupt

__all__ = ["MANIFEST", "Archive", "ZipArchive", "open_archive"]

MANIFEST = "manifest.json"

MAX_FILE_BYTES = 1 << 30
"""The largest file of a bundle: the largest known trunk (Wide-ResNet-50-2 with layer4) has 275 MB."""

MAX_MEMBERS = 4096


class Archive(Protocol):
    """The source of a bundle's files."""

    @property
    def where(self) -> str: ...

    def has(self, name: str) -> bool:
        """Tell whether there is anything of that name."""

    def read(self, name: str, limit: int = MAX_FILE_BYTES) -> bytes:
        """The bytes of one file. Errors: BundleCorrupt when missing, larger than the limit, or not a plain file."""


class _Folder:
    def __init__(self, path: Path) -> None:
        self.where = str(path)
        self._path = path

    def has(self, name: str) -> bool:
        return os.path.lexists(self._path / name)

    def read(self, name: str, limit: int = MAX_FILE_BYTES) -> bytes:
        try:
            with open(self._path / name, "rb", opener=_open_unfollowed) as file:
                status = os.fstat(file.fileno())
                if not stat.S_ISREG(status.st_mode):
                    raise BundleCorrupt(
                        f"bundle {self.where}: {name} is not a plain file; copy the complete bundle again"
                    )
                _check_size(self.where, name, status.st_size, limit)
                return file.read(limit + 1)
        except FileNotFoundError as error:
            raise _missing(self.where, name) from error
        except OSError as error:
            raise BundleCorrupt(
                f"bundle {self.where}: {name} cannot be read ({error.strerror}); copy the complete bundle again, "
                "links are not followed"
            ) from error


def _open_unfollowed(path: str, flags: int) -> int:
    """O_NONBLOCK: a named pipe in place of a file must not hang the gateway."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


class ZipArchive:
    def __init__(self, path: Path) -> None:
        self.where = str(path)
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError) as error:
            raise BundleCorrupt(
                f"bundle {path} is not a zip file that can be read ({error}); copy it again"
            ) from error
        members = self._zip.infolist()
        if len(members) > MAX_MEMBERS:
            raise BundleCorrupt(f"bundle {path} has {len(members)} members, at most {MAX_MEMBERS} are read")
        for member in members:
            _check_member(self.where, member)
        names = [member.filename for member in members]
        if len(set(names)) < len(names):
            raise BundleCorrupt(f"bundle {path} holds a file twice; make the zip again")
        self._root = _zip_root(names)

    def has(self, name: str) -> bool:
        return self._root + name in self._zip.NameToInfo

    def names(self) -> list[str]:
        """Every file of the bundle."""
        inside = (member.filename for member in self._zip.infolist() if not member.is_dir())
        return [name.removeprefix(self._root) for name in inside if name.startswith(self._root)]

    def read(self, name: str, limit: int = MAX_FILE_BYTES) -> bytes:
        try:
            member = self._zip.getinfo(self._root + name)
        except KeyError as error:
            raise _missing(self.where, name) from error
        _check_size(self.where, name, member.file_size, limit)
        try:
            with self._zip.open(member) as file:
                return file.read(limit + 1)
        except (
            zipfile.BadZipFile,
            zlib.error,
            EOFError,
            OSError,
            NotImplementedError,
            RuntimeError,
        ) as error:
            raise BundleCorrupt(
                f"bundle {self.where}: {name} cannot be unpacked ({error}); copy it again"
            ) from error


def _zip_root(names: list[str]) -> str:
    """'' where the manifest is at the top, 'folder/' where the bundle folder itself was zipped."""
    if MANIFEST in names:
        return ""
    roots = [
        name[: -len(MANIFEST)] for name in names if name.count("/") == 1 and name.endswith("/" + MANIFEST)
    ]
    return roots[0] if len(roots) == 1 else ""


def _check_member(where: str, member: zipfile.ZipInfo) -> None:
    name, mode = member.filename, member.external_attr >> 16
    fault = None
    if name.startswith("/") or "\\" in name or ":" in name or ".." in PurePosixPath(name).parts:
        fault = "points outside the bundle"
    elif stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        fault = "is a link or a device"
    elif member.flag_bits & 0x1:
        fault = "is encrypted"
    if fault:
        raise BundleCorrupt(
            f"bundle {where} is refused: its member '{name}' {fault}; make the zip from a bundle folder"
        )


def _check_size(where: str, name: str, size: int, limit: int) -> None:
    if size > limit:
        raise BundleCorrupt(
            f"bundle {where}: {name} has {size} bytes, at most {limit} were expected; copy the complete bundle again"
        )


def _missing(where: str, name: str) -> BundleCorrupt:
    other = "name the folder of a bundle, or " if name == MANIFEST else ""
    return BundleCorrupt(f"bundle {where}: {name} is missing; {other}copy the complete bundle again")


def open_archive(path: Path) -> Archive:
    """A folder or a zip. Errors: BundleCorrupt when it is neither or a member is refused."""
    if path.is_dir():
        return _Folder(path)
    if path.is_file():
        return ZipArchive(path)
    raise BundleCorrupt(f"no bundle at {path}: neither a folder nor a zip file; make one with `gelgate fit`")
