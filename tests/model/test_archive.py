"""A bundle's files: checked while reading, written completely or not at all."""

import os
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from edge.core.errors import BundleCorrupt
from edge.model.archive import open_archive
from edge.model.bundle_writer import write_bundle

FILES = {"manifest.json": b"{}", "bank/mean.npy": b"12345"}


def zip_with(path: Path, name: str, data: bytes = b"x", mode: int = stat.S_IFREG | 0o644) -> Path:
    """A valid zip with one more member."""
    write_bundle(path, FILES)
    with zipfile.ZipFile(path, "a") as archive:
        member = zipfile.ZipInfo(name)
        member.external_attr = mode << 16
        archive.writestr(member, data)
    return path


@pytest.mark.parametrize("name", ["b", "b.zip"])
def test_what_is_written_is_read(tmp_path: Path, name: str) -> None:
    """A folder and a zip hold the same files."""
    write_bundle(tmp_path / name, FILES)
    archive = open_archive(tmp_path / name)
    assert {file: archive.read(file) for file in FILES} == FILES


def test_equal_files_give_equal_zip_bytes(tmp_path: Path) -> None:
    """No time and no order of insertion gets into a zip."""
    write_bundle(tmp_path / "a.zip", FILES)
    write_bundle(tmp_path / "b.zip", dict(reversed(FILES.items())))
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_a_zipped_bundle_folder_is_a_bundle(tmp_path: Path) -> None:
    """`zip -r part.zip part/` puts the folder's name before each member; this is accepted."""
    write_bundle(tmp_path / "a.zip", {f"part/{name}": data for name, data in FILES.items()})
    assert open_archive(tmp_path / "a.zip").read("bank/mean.npy") == b"12345"


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "bank/../../evil", "bank\\evil", "C:evil"])
def test_a_zip_that_points_outside_is_refused(tmp_path: Path, name: str) -> None:
    """Absolute names and .. are refused before anything is read."""
    with pytest.raises(BundleCorrupt, match="points outside"):
        open_archive(zip_with(tmp_path / "a.zip", name))


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO])
def test_a_zip_with_a_link_or_device_is_refused(tmp_path: Path, kind: int) -> None:
    """A member is a plain file or a folder."""
    with pytest.raises(BundleCorrupt, match="link or a device"):
        open_archive(zip_with(tmp_path / "a.zip", "bank/link", b"/etc/passwd", kind | 0o777))


def test_a_zip_with_a_file_twice_is_refused(tmp_path: Path) -> None:
    """Two members of one name could show one to the check and the other to the reader."""
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = zip_with(tmp_path / "a.zip", "manifest.json")
    with pytest.raises(BundleCorrupt, match="twice"):
        open_archive(path)


@pytest.mark.parametrize("name", ["b", "b.zip"])
def test_a_file_larger_than_expected_is_not_read(tmp_path: Path, name: str) -> None:
    """The limit is checked before the bytes are read, so a zip bomb costs nothing."""
    write_bundle(tmp_path / name, FILES)
    with pytest.raises(BundleCorrupt, match="5 bytes, at most 4"):
        open_archive(tmp_path / name).read("bank/mean.npy", 4)


def test_a_zip_cut_short_is_refused(tmp_path: Path) -> None:
    """A half-copied zip has no directory at its end."""
    write_bundle(tmp_path / "a.zip", FILES)
    (tmp_path / "a.zip").write_bytes((tmp_path / "a.zip").read_bytes()[:-30])
    with pytest.raises(BundleCorrupt, match="copy it again"):
        open_archive(tmp_path / "a.zip")


@pytest.mark.parametrize("name", ["b", "b.zip"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    """The sentence says which file."""
    write_bundle(tmp_path / name, FILES)
    with pytest.raises(BundleCorrupt, match=r"golden/0\.png is missing"):
        open_archive(tmp_path / name).read("golden/0.png")


def test_a_link_in_a_folder_is_not_followed(tmp_path: Path) -> None:
    """A link could be turned to another file after the check."""
    write_bundle(tmp_path / "b", FILES)
    (tmp_path / "b" / "link.npy").symlink_to("/etc/hostname")
    with pytest.raises(BundleCorrupt, match="links are not followed"):
        open_archive(tmp_path / "b").read("link.npy")


def test_a_named_pipe_does_not_hang_the_reader(tmp_path: Path) -> None:
    """Only plain files are read."""
    write_bundle(tmp_path / "b", FILES)
    os.mkfifo(tmp_path / "b" / "pipe.npy")
    with pytest.raises(BundleCorrupt, match="not a plain file"):
        open_archive(tmp_path / "b").read("pipe.npy")


def test_a_folder_in_the_place_of_a_file_is_named(tmp_path: Path) -> None:
    """It is a fault of the bundle, not an OSError with the number of a descriptor."""
    write_bundle(tmp_path / "b", FILES)
    (tmp_path / "b" / "head.onnx").mkdir()
    with pytest.raises(BundleCorrupt, match=r"head\.onnx cannot be read \(Is a directory\)"):
        open_archive(tmp_path / "b").read("head.onnx")


def test_nothing_at_the_path_is_a_sentence(tmp_path: Path) -> None:
    """The sentence says how to make a bundle."""
    with pytest.raises(BundleCorrupt, match="gelgate fit"):
        open_archive(tmp_path / "nothing")


class Failing(Mapping[str, bytes]):
    """Files whose second read fails: the disk is full, or Ctrl-C was pressed."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __iter__(self):  # type: ignore[no-untyped-def]
        yield from ("manifest.json", "trunk.onnx")

    def __len__(self) -> int:
        return 2

    def __getitem__(self, name: str) -> bytes:
        if name == "trunk.onnx":
            raise self.error
        return b"{}"


@pytest.mark.parametrize("name", ["b", "b.zip"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_the_old_bundle(tmp_path: Path, name: str, error: BaseException) -> None:
    """A full disk or Ctrl-C in the middle: the old bundle is unchanged, and no part of a new one exists."""
    write_bundle(tmp_path / name, FILES)
    with pytest.raises(type(error)):
        write_bundle(tmp_path / name, Failing(error), overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert open_archive(tmp_path / name).read("bank/mean.npy") == b"12345"


@pytest.mark.parametrize("name", ["b", "b.zip"])
def test_an_existing_bundle_is_replaced_only_when_asked(tmp_path: Path, name: str) -> None:
    """Without `overwrite` nothing is lost; with it no file of the old one stays."""
    write_bundle(tmp_path / name, {**FILES, "old": b"old"})
    with pytest.raises(FileExistsError):
        write_bundle(tmp_path / name, FILES)
    write_bundle(tmp_path / name, FILES, overwrite=True)
    with pytest.raises(BundleCorrupt, match="missing"):
        open_archive(tmp_path / name).read("old")
    assert [p.name for p in tmp_path.iterdir()] == [name]
