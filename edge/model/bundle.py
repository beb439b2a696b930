"""A bundle: one detector for one position of one part, with everything that scoring needs, checked by hash.

`Bundle.load` reads a folder or a zip; `edge.model.bundle_writer` makes one. Every file is read once, and the
bytes that are hashed are the bytes that become arrays and sessions. The trunk is in the bundle, in a folder of trunks,
or among the installed backbones.
"""

import hashlib
import io
import json
import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from edge import registry
from edge.core.contact.reference import Reference
from edge.core.detector import Grid
from edge.core.drawn_regions import find_blind
from edge.core.errors import BundleCorrupt, BundleMismatch, GelgateError
from edge.core.imaging.decode import VIEW_SIZE
from edge.core.imaging.image_bytes import kind, picture_size
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.smoothing import smooth
from edge.model.archive import MANIFEST, MAX_FILE_BYTES, Archive, open_archive
from edge.model.manifest import (
    REGION_WEIGHTS,
    SCHEMA_VERSION,
    ArrayEntry,
    BackboneEntry,
    FileEntry,
    Manifest,
)
from edge.model.manifest_files import PicturesEntry, RegistrationEntry
from edge.model.onnx_validation import GraphRefused
from edge.model.packing import Packed, unpack
from edge.model.signature import UNSIGNED, Trust
from edge.pictures.nominal_pictures import NominalPictures

if TYPE_CHECKING:
    from edge.core.registration.registrar import PartInPose

__all__ = ["Bundle", "GoldenFrame", "Graphs", "parse_manifest", "read_trunk", "read_verified"]


def read_verified(archive: Archive, entry: FileEntry) -> bytes:
    """The bytes of that file. Errors: BundleCorrupt: missing, too large, or not the bytes that the manifest names."""
    data = archive.read(entry.file, min(entry.size_bytes, MAX_FILE_BYTES))
    digest = hashlib.sha256(data).hexdigest()
    if digest != entry.sha256:
        raise BundleCorrupt(
            f"bundle {archive.where}: {entry.file} has SHA-256 {digest[:12]} ({len(data)} bytes), the manifest expects "
            f"{entry.sha256[:12]} ({entry.size_bytes} bytes); copy the complete bundle again"
        )
    return data


def read_picture(
    archive: Archive, entry: FileEntry, frame: tuple[int, int], form: str = "png"
) -> NDArray[np.uint8]:
    """A picture of the region, uint8 (h, w, 3) RGB. A small file can hold a gigantic one: its size is read first."""
    data = read_verified(archive, entry)
    w, h = (kind(data) == form and picture_size(data)) or (0, 0)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if (h, w) == frame else None
    if bgr is None or bgr.dtype != np.uint8 or bgr.shape != (*frame, 3):
        raise BundleCorrupt(
            f"bundle {archive.where}: the picture {entry.file} is {h}x{w}, expected a {form.upper()} of "
            f"{frame[0]}x{frame[1]} (h, w) in colour; export the bundle again"
        )
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


def read_trunk(
    manifest: Manifest, archive: Archive, stores: Sequence[Path], loaded: Container[str]
) -> bytes | None:
    """The bytes of the trunk; None without one, and where its SHA-256 is among `loaded`.

    stores: folders of `<sha256>.onnx`, for a bundle that was sent without its trunk. Errors: BundleCorrupt.
    """
    if manifest.backbone is None or manifest.backbone.trunk.sha256 in loaded:
        return None
    entry = manifest.backbone.trunk
    if manifest.backbone.in_bundle:
        return read_verified(archive, entry)
    for store in stores:
        file = store / f"{entry.sha256}.onnx"
        if file.is_file():
            return read_verified(open_archive(store), entry.model_copy(update={"file": file.name}))
    installed = _installed_trunk(manifest.backbone, tuple(manifest.grid.taps) if manifest.grid else ())
    if installed is not None:
        return installed
    raise BundleCorrupt(
        f"bundle {archive.where} was sent without its trunk '{manifest.backbone.id}' and {entry.sha256[:12]} is not "
        f"in {' or '.join(map(str, stores)) or 'any trunk store'}; copy it there as {entry.sha256}.onnx"
    )


def _installed_trunk(backbone: BackboneEntry, taps: tuple[str, ...]) -> bytes | None:
    """The trunk of an installed backbone of that name, complete or cut after these taps, if the hash is the same."""
    if backbone.id not in registry.names("backbones"):
        return None
    from edge.model.graph_cut import cut_trunk  # a bundle mostly brings its trunk

    try:
        complete = registry.backbone(backbone.id).trunk()
        candidates = (complete, cut_trunk(complete, taps))
    except (GelgateError, GraphRefused, ImportError):
        return None
    wanted = backbone.trunk.sha256
    return next((trunk for trunk in candidates if hashlib.sha256(trunk).hexdigest() == wanted), None)


MAX_MANIFEST_BYTES = 16 << 20
TRUNK, HEAD, DETECTOR = "trunk.onnx", "head.onnx", "detector.onnx"
FREE_GEL = "free_gel.png"
FREE_VIEW = "free_view.png"


@dataclass(frozen=True)
class GoldenFrame:
    """A frame whose score is known."""

    rgb: NDArray[np.uint8]
    """uint8 (h, w, 3) of the inspected region."""
    what: str
    score: float
    map_peaks: tuple[tuple[float, ...], ...]
    """See GoldenEntry."""


@dataclass(frozen=True)
class Graphs:
    """The ONNX files of a bundle: trunk and head, or a single detector. Bytes, as loaded or to be written."""

    trunk: bytes | None = None
    head: bytes | None = None
    detector: bytes | None = None


@dataclass(frozen=True)
class Bundle:
    """A checked bundle in memory."""

    manifest: Manifest
    graphs: Graphs
    """Without a trunk where the caller has it open already."""
    bank: Mapping[str, NDArray[Any]]
    """Unpacked arrays, as the head's inputs need them."""
    golden: tuple[GoldenFrame, ...]
    digest: str
    """SHA-256 of the manifest, the bundle's identity in every published result."""
    where: str
    """Path, for messages."""
    free_gel: NDArray[np.uint8] | None = None
    """The region without contact, (h, w, 3), where tiles may be skipped."""
    free_view: NDArray[np.uint8] | None = None
    """The whole gel without contact, as contact detection sees it, (120, 160, 3)."""
    signature: str = UNSIGNED
    """Who made it, as far as that was checked, in words."""
    registration: "PartInPose | None" = None
    """The part in the bank's pose; None for a bundle that scores presses without registration."""
    nominal_pictures: NominalPictures | None = None
    """What people are shown beside a press; None for an old bundle and a wrapped one."""

    @classmethod
    def load(
        cls,
        path: str | Path,
        trunks: Path | None = None,
        loaded: Container[str] = (),
        trust: Trust = Trust(),  # noqa: B008  # frozen
    ) -> "Bundle":
        """Read and verify a bundle, a folder or a zip.

        trunks: folder of `<sha256>.onnx`, for bundles sent without their trunk; then `trunks/` next to the bundle and
        the installed backbones are tried. loaded: SHA-256 of trunks that are already open and are not read. trust:
        whose bundles are accepted. Errors: BundleCorrupt (which file, found, expected), BundleMismatch (from a newer
        program, or not signed as required).
        """
        archive = open_archive(Path(path))
        raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
        signature = trust.check(archive, raw)
        manifest = parse_manifest(raw, archive.where)
        stores = [folder for folder in (trunks, Path(path).parent / "trunks") if folder is not None]
        bundle = cls._assemble(manifest, hashlib.sha256(raw).hexdigest(), archive, stores, loaded)
        return replace(bundle, signature=signature)

    @classmethod
    def in_memory(
        cls,
        manifest: Manifest,
        files: Mapping[str, bytes],
        where: str = "unwritten",
        loaded: Container[str] = (),
    ) -> "Bundle":
        """The bundle of these files, with the same checks, so fit scores what a gateway will load."""
        return cls._assemble(
            manifest, hashlib.sha256(files[MANIFEST]).hexdigest(), _Memory(files, where), (), loaded
        )

    @classmethod
    def _assemble(
        cls, manifest: Manifest, digest: str, archive: Archive, stores: Sequence[Path], loaded: Container[str]
    ) -> "Bundle":
        graphs = Graphs(
            trunk=read_trunk(manifest, archive, stores, loaded),
            head=read_verified(archive, manifest.head) if manifest.head else None,
            detector=read_verified(archive, manifest.detector) if manifest.detector else None,
        )
        bank = {name: _read_array(archive, name, entry) for name, entry in manifest.bank.items()}
        golden = tuple(
            GoldenFrame(read_picture(archive, one.image, manifest.frame), one.what, one.score, one.map_peaks)
            for one in manifest.golden
        )
        return cls(
            manifest=manifest,
            graphs=graphs,
            bank=bank,
            golden=golden,
            digest=digest,
            where=archive.where,
            free_gel=read_picture(archive, manifest.free_gel, manifest.frame) if manifest.free_gel else None,
            free_view=read_picture(archive, manifest.free_view, VIEW_SIZE[::-1])
            if manifest.free_view
            else None,
            registration=_read_registration(archive, manifest.registration, manifest.frame),
            nominal_pictures=_read_nominal_pictures(archive, manifest.nominal_pictures),
        )

    def prepare(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Fill marker dots in a picture of the region, uint8 (h, w, 3), and smooth it, as in the learnt presses."""
        dots = self.manifest.dots
        filled = rgb if dots is None else dots.opened.fill(rgb)
        return smooth(filled) if self.manifest.is_smoothed else filled

    @property
    def profile(self) -> SensorProfile:
        return self.manifest.profile

    @property
    def region(self) -> Region:
        return self.manifest.region

    @property
    def free_reference(self) -> Reference | None:
        """The untouched gel of the sensor that the bundle was fitted on."""
        return None if self.free_view is None else Reference(self.free_view.astype(np.float32))

    @cached_property
    def blind(self) -> NDArray[np.bool_] | None:
        """The places of the bank's pose that drawn regions leave out, bool (h, w); None for none."""
        weights = self.bank.get(REGION_WEIGHTS)
        return None if weights is None else find_blind(weights)

    @property
    def free_region(self) -> NDArray[np.uint8] | None:
        """The inspected region of the untouched gel, uint8 (h, w, 3); None where it is not known."""
        if self.registration is not None:
            return self.registration.free
        if self.free_view is None:
            return None
        return self.region.crop(np.asarray(cv2.resize(self.free_view, self.profile.size), np.uint8))

    @property
    def grid(self) -> Grid | None:
        return self.manifest.grid.grid() if self.manifest.grid else None

    @property
    def trunk_sha256(self) -> str | None:
        return self.manifest.backbone.trunk.sha256 if self.manifest.backbone else None


def parse_manifest(raw: bytes, where: str) -> Manifest:
    """The manifest from its bytes. Errors: BundleCorrupt, BundleMismatch for a newer schema."""
    try:
        content = json.loads(raw)
        json.dumps(content, ensure_ascii=False).encode()  # half a character cannot be printed or hashed
        version = content["schema_version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BundleCorrupt(
            f"bundle {where}: {MANIFEST} is not a gelgate manifest ({error!r:.100})"
        ) from error
    if isinstance(version, int) and version > SCHEMA_VERSION:
        raise BundleMismatch(
            f"bundle {where} has manifest schema {version}, this program reads up to {SCHEMA_VERSION}; "
            "update gelgate on this gateway"
        )
    try:
        return Manifest.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(
            f"{'.'.join(map(str, e['loc'])) or 'manifest'}: {e['msg']}" for e in error.errors()[:5]
        )
        raise BundleCorrupt(
            f"bundle {where}: {MANIFEST} is wrong: {faults}; export the bundle again"
        ) from error


def _read_array(archive: Archive, name: str, entry: ArrayEntry) -> NDArray[Any]:
    stored_dtype = {"none": entry.dtype, "float16": "float16", "int8": "int8"}[entry.packing]
    data = _parse_npy(
        read_verified(archive, entry.data), entry.data.file, stored_dtype, entry.shape, archive.where
    )
    scale = None
    if entry.scale is not None:
        raw = read_verified(archive, entry.scale)
        scale = _parse_npy(raw, entry.scale.file, "float32", entry.shape[:-1], archive.where)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            array = unpack(Packed(data, scale, entry.exponent), entry.packing)
    except ValueError as error:
        raise BundleCorrupt(
            f"bundle {archive.where}: bank array '{name}': {error}; export it again"
        ) from error
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise BundleCorrupt(f"bundle {archive.where}: bank array '{name}' holds NaN or infinity; fit again")
    return array


def _parse_npy(data: bytes, file: str, dtype: str, shape: tuple[int, ...], where: str) -> NDArray[Any]:
    """An array from npy bytes; its header must agree with the manifest."""
    stream = io.BytesIO(data)
    try:
        major, _ = np.lib.format.read_magic(stream)
        reader = np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
        found_shape, fortran, found_dtype = reader(stream)
    except Exception as error:  # numpy parses the header as Python text, and lets errors of that through
        raise BundleCorrupt(f"bundle {where}: {file} is not a npy file ({error}); export it again") from error
    if found_dtype.hasobject or found_dtype != np.dtype(dtype) or found_shape != shape or fortran:
        raise BundleCorrupt(
            f"bundle {where}: {file} holds {found_dtype} {found_shape}, the manifest expects {dtype} {shape}; "
            "export the bundle again"
        )
    found_bytes, expected_bytes = len(data) - stream.tell(), math.prod(shape) * np.dtype(dtype).itemsize
    if found_bytes != expected_bytes:
        raise BundleCorrupt(
            f"bundle {where}: {file} holds {found_bytes} bytes of data, {expected_bytes} were expected; "
            "copy the complete bundle again"
        )
    return np.frombuffer(data, found_dtype, offset=stream.tell()).reshape(shape)


def _read_registration(
    archive: Archive, entry: RegistrationEntry | None, frame: tuple[int, int]
) -> "PartInPose | None":
    """Read the part in its pose; None for a bundle without one. frame: (h, w) of the region. Errors: BundleCorrupt."""
    if entry is None:
        return None
    from edge.core.registration.colours import SlopeColours  # most bundles need none of it
    from edge.core.registration.pose import GEL_LIMIT_STEPS
    from edge.core.registration.registrar import PartInPose

    limits = None if entry.gel_limits is None else read_picture(archive, entry.gel_limits, frame)[..., 0]
    try:
        return PartInPose(
            free=read_picture(archive, entry.free, frame),
            template=read_picture(archive, entry.template, frame),
            learnt=read_picture(archive, entry.learnt, frame)[..., 0] > 127,
            colours=SlopeColours(np.array(entry.colours)),
            symmetry=entry.symmetry if entry.is_turning else 0,
            nearly=entry.nearly,
            least_match=entry.least_match,
            least_seen=entry.least_seen,
            is_held=entry.is_held,
            scores_relief_to_end=entry.scores_relief_to_end,
            gel_limits=None if limits is None else limits.astype(np.float32) / np.float32(GEL_LIMIT_STEPS),
        )
    except ValueError as error:
        raise BundleCorrupt(f"bundle {archive.where}: registration: {error}; fit again") from error


def _read_nominal_pictures(archive: Archive, entry: PicturesEntry | None) -> NominalPictures | None:
    """Read them as the file that they are; it is looked into once, so that it can be drawn. Errors: BundleCorrupt."""
    if entry is None:
        return None
    w, h = entry.size
    read_picture(archive, entry.file, (h * len(entry.names), w), "jpg")
    return NominalPictures(read_verified(archive, entry.file), entry.size, entry.names)


@dataclass(frozen=True)
class _Memory:
    files: Mapping[str, bytes]
    where: str

    def has(self, name: str) -> bool:
        return name in self.files

    def read(self, name: str, limit: int = 0) -> bytes:
        return self.files[name]
