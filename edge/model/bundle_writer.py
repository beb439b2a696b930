"""Writes bundles: the manifest and the files of a new one, completely or not at all, and one more file of another."""

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import io
import json
import os
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.core.detector import Bank
from edge.core.errors import FitError
from edge.core.registration.pose import GEL_LIMIT_STEPS
from edge.core.registration.registrar import PartInPose
from edge.model.archive import MANIFEST, ZipArchive, open_archive
from edge.model.bundle import DETECTOR, FREE_GEL, FREE_VIEW, HEAD, TRUNK, Bundle, GoldenFrame, Graphs
from edge.model.manifest import ArrayEntry, BackboneEntry, Facts, FileEntry, GoldenEntry, Manifest
from edge.model.manifest_files import PicturesEntry, RegistrationEntry
from edge.model.packing import pack
from edge.pictures.nominal_pictures import NominalPictures

__all__ = [
    "add_file",
    "array_entry",
    "bundle_files",
    "facts_of",
    "keep_file",
    "manifest_bytes",
    "replace_bundle",
    "rewrite_files",
    "write_bundle",
    "write_file",
]

# Zip knows no time zone and no year before 1980: every member carries this time, so equal content gives equal bytes.
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)

# Linux's renameat2(2): paths are relative to the working folder, and the two are exchanged.
_AT_FDCWD: Final = -100
_RENAME_EXCHANGE: Final = 2


def facts_of(manifest: Manifest) -> Facts:
    """Return the manifest without its files."""
    return Facts(**{name: getattr(manifest, name) for name in Facts.model_fields})


def bundle_files(
    facts: Facts,
    graphs: Graphs,
    bank: Bank | None = None,
    golden: Sequence[GoldenFrame] = (),
    *,
    backbone: str = "",
    with_trunk: bool = True,
    free_gel: NDArray[np.uint8] | None = None,
    free_view: NDArray[np.uint8] | None = None,
    registration: PartInPose | None = None,
    nominal_pictures: NominalPictures | None = None,
) -> tuple[Manifest, dict[str, bytes]]:
    """The manifest and the files of a new bundle, the manifest among them; equal inputs give equal bytes.

    backbone: the trunk's id. with_trunk: False leaves the trunk to the gateway's store. Errors: FitError for an array
    that cannot be stored as the bank states.
    """
    files: dict[str, bytes] = {}
    keep = partial(keep_file, files)
    parts: dict[str, Any] = {}
    if graphs.trunk is not None:
        parts["backbone"] = BackboneEntry(id=backbone, trunk=keep(TRUNK, graphs.trunk), in_bundle=with_trunk)
        if not with_trunk:
            del files[TRUNK]
    for key, name, graph in (("head", HEAD, graphs.head), ("detector", DETECTOR, graphs.detector)):
        if graph is not None:
            parts[key] = keep(name, graph)
    if bank is not None:
        parts["bank"] = {name: array_entry(name, bank, keep) for name in sorted(bank.arrays)}
    parts["golden"] = tuple(
        GoldenEntry(
            image=keep(f"golden/{number}.png", png_bytes(frame.rgb)),
            what=frame.what,
            score=frame.score,
            map_peaks=frame.map_peaks,
        )
        for number, frame in enumerate(golden)
    )
    if free_gel is not None:
        parts["free_gel"] = keep(FREE_GEL, png_bytes(free_gel))
    if free_view is not None:
        parts["free_view"] = keep(FREE_VIEW, png_bytes(free_view))
    if registration is not None:
        parts["registration"] = _registration_entry(registration, keep)
    if (pictures := nominal_pictures) is not None:
        file = keep("nominal/pictures.jpg", pictures.jpeg)
        parts["nominal_pictures"] = PicturesEntry(file=file, size=pictures.size, names=pictures.names)
    manifest = Manifest(**{name: getattr(facts, name) for name in Facts.model_fields}, **parts)
    files[MANIFEST] = manifest_bytes(manifest)
    return manifest, files


def rewrite_files(
    bundle: Bundle, facts: Facts, golden: Sequence[GoldenFrame], **changes: Any
) -> tuple[Manifest, dict[str, bytes]]:
    """Return the manifest and files of a bundle with other facts and golden frames.

    changes: what else is not the bundle's, as arguments of `bundle_files`.
    """
    entries, backbone = bundle.manifest.bank, bundle.manifest.backbone
    packing = {name: entry.packing for name, entry in entries.items()}
    kept = {
        "graphs": bundle.graphs,
        "bank": Bank(bundle.bank, packing) if entries else None,
        "backbone": backbone.id if backbone else "",
        "with_trunk": backbone is None or backbone.in_bundle,
        "free_gel": bundle.free_gel,
        "free_view": bundle.free_view,
        "registration": bundle.registration,
        "nominal_pictures": bundle.nominal_pictures,
    }
    return bundle_files(facts, golden=golden, **kept | changes)


def manifest_bytes(manifest: Manifest) -> bytes:
    """The manifest's file; its SHA-256 is the bundle's identity. Older programs read it where nothing newer is set."""
    newer = ("revision", "registration", "dots", "is_smoothed", "regions", "nominal_pictures")
    unset = {name for name in newer if getattr(manifest, name) in (None, False)}
    return (
        json.dumps(manifest.model_dump(mode="json", exclude=unset), indent=1, ensure_ascii=False) + "\n"
    ).encode()


def keep_file(files: dict[str, bytes], name: str, data: bytes) -> FileEntry:
    """Add a file to those of a bundle; returns its entry."""
    files[name] = data
    return FileEntry(file=name, sha256=hashlib.sha256(data).hexdigest(), size_bytes=len(data))


def array_entry(name: str, bank: Bank, keep: Callable[[str, bytes], FileEntry]) -> ArrayEntry:
    """Make the entry of one array of the bank. keep: stores a file by its name. Errors: FitError."""
    array, packing = bank.arrays[name], bank.packing.get(name, "none")
    if array.dtype not in (np.float32, np.int64, np.bool_):
        raise FitError(f"bank array '{name}' is {array.dtype}; a head takes float32, int64 or bool")
    try:
        packed = pack(array, packing)
    except ValueError as error:
        raise FitError(f"bank array '{name}' cannot be stored: {error}") from error
    return ArrayEntry(
        dtype=array.dtype.name,  # type: ignore[arg-type]  # one of the three just checked
        shape=array.shape,
        packing=packing,
        data=keep(f"bank/{name}.npy", _npy(packed.data)),
        scale=None if packed.scale is None else keep(f"bank/{name}.scale.npy", _npy(packed.scale)),
        exponent=packed.exponent,
    )


def _npy(array: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(
        stream, np.ascontiguousarray(array).reshape(array.shape), (1, 0), allow_pickle=False
    )
    return stream.getvalue()


def _registration_entry(part: PartInPose, keep: Callable[[str, bytes], FileEntry]) -> RegistrationEntry:
    """The manifest's entry. keep: stores a file by its name."""
    learnt, limits = np.where(part.learnt, np.uint8(255), np.uint8(0)), part.gel_limits
    red, green, blue = ((float(x), float(y)) for x, y in part.colours.matrix)
    return RegistrationEntry(
        free=keep("registration/free.png", png_bytes(part.free)),
        template=keep("registration/template.png", png_bytes(part.template)),
        learnt=keep("registration/learnt.png", _grey_png(learnt)),
        colours=(red, green, blue),
        is_turning=part.is_turning,
        symmetry=max(1, part.symmetry),
        nearly=part.nearly,
        least_match=part.least_match,
        least_seen=part.least_seen,
        is_held=part.is_held,
        scores_relief_to_end=part.scores_relief_to_end,
        gel_limits=None
        if limits is None
        else keep("registration/gel_limits.png", _grey_png((limits * GEL_LIMIT_STEPS).astype(np.uint8))),
    )


def _grey_png(levels: NDArray[np.uint8]) -> bytes:
    return png_bytes(np.repeat(levels[..., None], 3, axis=2))


def png_bytes(rgb: NDArray[np.uint8]) -> bytes:
    """uint8 (h, w, 3) RGB as a PNG file."""
    return bytes(cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1])


def write_bundle(path: Path, files: Mapping[str, bytes], *, overwrite: bool = False) -> Path:
    """Write all files as a folder, or as a zip when the name ends in .zip; appears at once or not at all.

    Equal files give equal bytes. Of several writers at once the last wins, without `overwrite` the first. Errors:
    FileExistsError; OSError of the disk, with nothing left behind.
    """
    _refuse_existing(path, overwrite)
    with _place_beside(path) as partial:
        if path.suffix == ".zip":
            _write_zip(partial, files)
        else:
            for name, data in files.items():
                _write_synced(partial / name, data)
        with _locked(path.parent):
            _refuse_existing(path, overwrite)
            _put_in_place(partial, path)
    return path


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already; choose another name or allow it to be replaced")


@contextlib.contextmanager
def _place_beside(path: Path) -> Iterator[Path]:
    """Give a place to write what shall be at a path: on its disk, of no other writer, and gone at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.partial-", dir=path.parent))
    try:
        yield folder / "new"
    finally:
        _remove(folder)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one writer at a time put something in its place in a folder."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # one that cannot be read, or NFS, has no lock
            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def add_file(bundle: Path, name: str, data: bytes) -> None:
    """Add one small file to a bundle, or replace it; at once or not at all.

    A zip is written again as a whole. Errors: BundleCorrupt, OSError.
    """
    archive = open_archive(bundle)
    if not isinstance(archive, ZipArchive):
        write_file(bundle / name, data)
    else:
        files = {kept: archive.read(kept) for kept in archive.names() if kept != name}
        write_bundle(bundle, {**files, name: data}, overwrite=True)


def write_file(path: Path, data: bytes) -> None:
    """Write one file that appears at once or not at all, replacing an older one. Errors: OSError."""
    with _place_beside(path) as partial:
        _write_synced(partial, data)
        partial.replace(path)


def _write_synced(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as out:
        out.write(data)
        out.flush()
        os.fsync(out.fileno())


def _write_zip(file: Path, files: Mapping[str, bytes]) -> None:
    with file.open("wb") as out:
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in sorted(files.items()):
                member = zipfile.ZipInfo(name, ZIP_EPOCH)
                member.compress_type = zipfile.ZIP_DEFLATED
                member.external_attr = (stat.S_IFREG | 0o644) << 16
                archive.writestr(member, data)
        out.flush()
        os.fsync(out.fileno())


def replace_bundle(path: Path, new: Path, kept: Path) -> None:
    """Put a new bundle in the place of this one, which is at `kept` then.

    Whenever this ends, as by a kill, a complete bundle is at `path`. Errors: OSError, as where the file system cannot
    exchange two folders; then the bundle is as it was, and there is no new one.
    """
    try:
        _remove(kept)
        new.rename(kept)
        _exchange(kept, path)
    except OSError:
        _remove(kept)
        _remove(new)
        raise


def _exchange(one: Path, other: Path) -> None:
    """Exchange two names at once. Errors: OSError where the system or the file system cannot."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if call(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), ctypes.c_uint(_RENAME_EXCHANGE)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _put_in_place(partial: Path, path: Path) -> None:
    """Rename to the final path. Where the system cannot exchange folders, one that exists is moved away first, so a
    kill between leaves none."""
    if not path.is_dir():
        partial.rename(path)
        return
    with contextlib.suppress(OSError):
        _exchange(partial, path)
        return  # the old one is removed as the partial one
    aside = path.with_name(f".{path.name}.replaced-{os.getpid()}")
    _remove(aside)
    path.rename(aside)
    try:
        partial.rename(path)
    except OSError:
        aside.rename(path)
        raise
    _remove(aside)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
