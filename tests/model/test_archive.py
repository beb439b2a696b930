"""A bundle's files: checked while reading, written completely or not at all."""

import os
import stat
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from unittest.mock import Mock

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


@pytest.mark.parametrize(
    ("name", "kind", "sentence"),
    [
        *((name, stat.S_IFREG, "points outside")
          for name in ("../evil", "/etc/evil", "bank/../../evil", "bank\\evil", "C:evil")),
        *(("bank/link", kind, "link or a device") for kind in (stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO)),
    ],
)  # fmt: skip
def test_a_zip_of_other_than_files_is_refused(tmp_path: Path, name: str, kind: int, sentence: str) -> None:
    """Absolute names, `..`, links and devices are refused before anything is read."""
    with pytest.raises(BundleCorrupt, match=sentence):
        open_archive(zip_with(tmp_path / "a.zip", name, b"/etc/passwd", kind | 0o644))


def test_a_zip_with_a_file_twice_is_refused(tmp_path: Path) -> None:
    """Two members of one name could show one to the check and the other to the reader."""
    with pytest.warns(UserWarning, match="Duplicate name"):
        path = zip_with(tmp_path / "a.zip", "manifest.json")
    with pytest.raises(BundleCorrupt, match="twice"):
        open_archive(path)


@pytest.mark.parametrize("name", ["b", "b.zip"])
def test_a_file_that_is_larger_than_expected_or_missing_is_named(tmp_path: Path, name: str) -> None:
    """The limit is checked before the bytes are read, so a zip bomb costs nothing."""
    write_bundle(tmp_path / name, FILES)
    with pytest.raises(BundleCorrupt, match="5 bytes, at most 4"):
        open_archive(tmp_path / name).read("bank/mean.npy", 4)
    with pytest.raises(BundleCorrupt, match=r"golden/0\.png is missing"):
        open_archive(tmp_path / name).read("golden/0.png")


def test_a_zip_cut_short_is_refused(tmp_path: Path) -> None:
    """A half-copied zip has no directory at its end."""
    write_bundle(tmp_path / "a.zip", FILES)
    (tmp_path / "a.zip").write_bytes((tmp_path / "a.zip").read_bytes()[:-30])
    with pytest.raises(BundleCorrupt, match="copy it again"):
        open_archive(tmp_path / "a.zip")


@pytest.mark.parametrize(
    ("place", "sentence"),
    [
        (lambda path: path.symlink_to("/etc/hostname"), "links are not followed"),
        (os.mkfifo, "not a plain file"),
        (Path.mkdir, r"odd\.npy cannot be read \(Is a directory\)"),
    ],
    ids=["link", "pipe", "folder"],
)
def test_only_plain_files_are_read(tmp_path: Path, place: Callable[[Path], object], sentence: str) -> None:
    """A link could be turned to another file after the check, and a pipe would hang the reader."""
    write_bundle(tmp_path / "b", FILES)
    place(tmp_path / "b" / "odd.npy")
    with pytest.raises(BundleCorrupt, match=sentence):
        open_archive(tmp_path / "b").read("odd.npy")


def test_nothing_at_the_path_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(BundleCorrupt, match="gelgate fit"):
        open_archive(tmp_path / "nothing")


class Halfway(Mapping[str, bytes]):
    """Files, at the second read of which something happens: another writes, the disk is full, Ctrl-C was pressed."""

    def __init__(self, happen: Callable[[], object]) -> None:
        self.happen = happen

    def __iter__(self):  # type: ignore[no-untyped-def]
        yield from FILES

    def __len__(self) -> int:
        return len(FILES)

    def __getitem__(self, name: str) -> bytes:
        if name == "bank/mean.npy":
            self.happen()
        return FILES[name]


@pytest.mark.parametrize("name", ["b", "b.zip"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_the_old_bundle(tmp_path: Path, name: str, error: BaseException) -> None:
    """A full disk or Ctrl-C in the middle: the old bundle is unchanged, and no part of a new one exists."""
    write_bundle(tmp_path / name, FILES)
    with pytest.raises(type(error)):
        write_bundle(tmp_path / name, Halfway(Mock(side_effect=error)), overwrite=True)
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


OTHERS = {"manifest.json": b"{1}", "trunk.onnx": b"67890"}


@pytest.mark.parametrize("name", ["b", "b.zip"])
@pytest.mark.parametrize("is_replacing", [True, False])
def test_of_two_writers_at_once_one_wins_whole(tmp_path: Path, name: str, is_replacing: bool) -> None:
    """The last, or the first where none may be replaced: in one process too."""
    other = partial(write_bundle, tmp_path / name, OTHERS, overwrite=is_replacing)
    refused = (
        nullcontext() if is_replacing else pytest.raises(FileExistsError, match="exists already; choose")
    )
    with refused:
        write_bundle(tmp_path / name, Halfway(other), overwrite=is_replacing)
    archive, (winner, loser) = (
        open_archive(tmp_path / name),
        (FILES, OTHERS) if is_replacing else (OTHERS, FILES),
    )
    assert {one: archive.read(one) for one in winner} == winner
    with pytest.raises(BundleCorrupt, match="missing"):
        archive.read(max(loser.keys() - winner))
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_writers_wait_where_two_folders_cannot_be_exchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each moves the one that is there away, and puts its own in the place."""
    monkeypatch.setattr("edge.model.bundle_writer._exchange", Mock(side_effect=OSError))
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: write_bundle(tmp_path / "b", FILES, overwrite=True), range(64)))
    assert open_archive(tmp_path / "b").read("bank/mean.npy") == b"12345"
    assert [p.name for p in tmp_path.iterdir()] == ["b"]
