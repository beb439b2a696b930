"""Nominal presses from the user's sources: recordings, folders of pictures, single pictures.

From a recording the contact tracker takes the settled frame of every press, exactly like the gateway, and frames of the
free gel. Each picture is a press; with a picture of the free gel its touched area is known too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset.files import SUFFIXES, read_rgb
from calibration.dataset.press import numbered
from calibration.fitting.presses.recorded_presses import FoundPress, PressFinder
from calibration.fitting.presses.sources import check_present
from edge.core.contact.mask import Touch, touched, touched_mask
from edge.core.contact.press_detector import PressDetector
from edge.core.contact.reference import Reference, View
from edge.core.contact.relief import ReliefOfReference, with_relief
from edge.core.contact.settings import ContactSettings
from edge.core.errors import DatasetError, FitError
from edge.core.imaging.decode import VIEW_SIZE, decode
from edge.core.imaging.quality import BLACK_LEVEL
from edge.core.imaging.region import Region, touched_in
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.suggest import suggestion
from edge.recording.format import Recording
from edge.recording.from_images import images_in

__all__ = [
    "MIN_PRESSES",
    "NominalPresses",
    "is_recording",
    "listed_pictures",
    "lit",
    "named_presses",
    "read_presses",
    "specimen_of",
    "touched_union",
    "why_unread",
]

MIN_PRESSES = 4
"""Presses that a threshold needs: a fold then keeps three. Of two or one there is no covariance and no spread between
presses, and the fold's scores have another scale than the bank's: with two presses PaDiM's threshold was 30 times the
nominal scores."""

# Frames of the free gel that are kept: the detectors need only its mean and its noise.
MAX_NO_CONTACT = 16

# A new press is slightly off the old ones: one tenth of a gel's useful width (18.6 mm, datasheet) is 1.9 mm.
TOUCHED_MARGIN_MM = 1.0


# The fields with one entry per press.
_EACH = ("names", "specimens", "touches", "reliefs")


@dataclass(frozen=True)
class NominalPresses:
    """Nominal presses of one position, cut to the inspected region.

    frames: uint8 (n, h, w, 3) RGB. names, specimens: one each per press, specimen None when unknown. touches: area and
    centroid in the picture, empty when there is no free gel to compare with. touched: bool (h, w), the union of what
    the presses touch with a margin of 1 mm. no_contact: uint8 (m, h, w, 3), the free gel. left_out: names of presses
    found and left out. free_view: the free gel as contact detection sees it, uint8 (120, 160, 3).
    reliefs: the share of the view in which each press shows an imprint's fine structure, empty when there is no free
    gel. faults: parts of the sources that could not be read or found, a sentence each.
    """

    frames: NDArray[np.uint8]
    names: tuple[str, ...]
    specimens: tuple[str | None, ...] = ()
    touches: tuple[Touch, ...] = ()
    touched: NDArray[np.bool_] | None = None
    no_contact: NDArray[np.uint8] | None = None
    left_out: tuple[str, ...] = ()
    free_view: NDArray[np.uint8] | None = None
    reliefs: tuple[float, ...] = ()
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.frames.ndim != 4 or self.frames.shape[3] != 3 or self.frames.dtype != np.uint8:
            raise ValueError(f"frames are uint8 (n, h, w, 3), found {self.frames.dtype} {self.frames.shape}")
        if not self.specimens:
            object.__setattr__(self, "specimens", (None,) * len(self.frames))
        for what in (getattr(self, name) for name in _EACH):
            if what and len(what) != len(self.frames):
                raise ValueError(
                    f"{len(self.frames)} frames with {len(what)} names, specimens, touches or reliefs"
                )

    def __len__(self) -> int:
        return len(self.frames)

    def spread(self, most: int) -> "NominalPresses":
        """At most this many of them, evenly spread."""
        if len(self) <= most:
            return self
        return self._choose(np.linspace(0, len(self) - 1, most).round().astype(int).tolist())

    def first(self, count: int) -> "NominalPresses":
        """Return the first ones."""
        return self._choose(range(min(count, len(self))))

    def _choose(self, rows: Sequence[int]) -> "NominalPresses":
        kept = {name: tuple(getattr(self, name)[k] for k in rows if getattr(self, name)) for name in _EACH}
        return replace(self, frames=self.frames[list(rows)], **kept)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _Contact:
    """Where a press touches, bool (120, 160), and the share of the view in which it shows fine structure."""

    mask: NDArray[np.bool_]
    relief: float


@dataclass
class _Gathered:
    """The presses found while sources are read, one entry each."""

    profile: SensorProfile
    region: Region
    frames: list[NDArray[np.uint8]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    specimens: list[str | None] = field(default_factory=list)
    contacts: list[_Contact | None] = field(default_factory=list)
    free: list[NDArray[np.uint8]] = field(default_factory=list)
    unwanted: frozenset[str] = frozenset()
    left_out: list[str] = field(default_factory=list)
    free_views: list[View] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def add(
        self, picture: NDArray[np.uint8], name: str, specimen: str | None, contact: _Contact | None
    ) -> None:
        if name in self.unwanted:
            self.left_out.append(name)
            return
        self.frames.append(self.region.crop(picture).copy())
        self.names.append(name)
        self.specimens.append(specimen)
        self.contacts.append(contact)

    def add_free(self, picture: NDArray[np.uint8]) -> None:
        self.free.append(self.region.crop(picture))
        self.free_views.append(_view(picture))

    def presses(self) -> NominalPresses:
        contacts = [contact for contact in self.contacts if contact is not None]
        is_known = len(contacts) == len(self.frames)
        masks = [contact.mask for contact in contacts]
        return NominalPresses(
            frames=np.stack(self.frames),
            names=tuple(self.names),
            specimens=tuple(self.specimens),
            touches=tuple(touched(mask) for mask in masks) if is_known else (),
            touched=touched_union(masks, self.profile, self.region) if is_known else None,
            no_contact=np.stack(self.free[:MAX_NO_CONTACT]) if self.free else None,
            left_out=tuple(self.left_out),
            free_view=self._free_view(),
            reliefs=tuple(contact.relief for contact in contacts) if is_known else (),
            faults=tuple(self.faults),
        )

    def _free_view(self) -> NDArray[np.uint8] | None:
        if not self.free_views:
            return None
        mean = np.mean(self.free_views[:MAX_NO_CONTACT], axis=0, dtype=np.float64)
        return np.asarray(np.rint(mean), np.uint8)


def is_recording(source: Path) -> bool:
    """Whether a folder is a recording rather than a folder of pictures."""
    return (source / "recording.toml").is_file()


def read_presses(
    sources: Sequence[Path],
    profile: SensorProfile,
    region: Region,
    *,
    no_contact: Sequence[Path] | None = None,
    resize: bool = False,
    pattern: str | None = None,
    specimens: Mapping[Path, str | None] = MappingProxyType({}),
    leave_out: Sequence[str] | None = None,
) -> NominalPresses:
    """The nominal presses of all sources together: recordings, folders of pictures, or pictures.

    A picture has the camera's size (it is cut and scaled as the profile says) or the profile's own; resize allows any
    other, cut to the profile's aspect. pattern: which files of a folder, those below it too; None: those directly
    inside. no_contact: pictures, or folders of them, of the free gel. specimens: of pictures, where their names do not
    have it. leave_out: names of presses to leave out, as a bundle lists them. Errors: RecordingError, DatasetError
    listing every faulty picture, FitError when there is no press, or no press of a name to leave out.
    """
    gathered = _Gathered(profile, region, unwanted=frozenset(leave_out or ()))
    free_files = listed_pictures(no_contact or ())
    free = _pictures(free_files, profile, resize)
    for _, picture in free:
        gathered.add_free(picture)
    contact = _contacts([picture for _, picture in free])
    for source in sources:
        if is_recording(source):
            _read_recording(source, gathered)
    files = listed_pictures([source for source in sources if not is_recording(source)], pattern)
    files = [path for path in files if not any(path.samefile(one) for one in free_files)]
    for path, picture in _pictures(files, profile, resize):
        gathered.add(picture, _name(path), specimens.get(path) or specimen_of(path), contact(picture))
    _require_left_out(gathered)
    if not gathered.frames and gathered.refused:
        raise FitError("no press was found: " + "; ".join(gathered.refused))
    if not gathered.frames:
        raise FitError(
            f"no press was found in {', '.join(map(str, sources)) or 'no source'}; give a recording with presses or a "
            "folder of pictures"
        )
    return gathered.presses()


def _require_left_out(gathered: _Gathered) -> None:
    """Errors: FitError with the nearest name for an unknown one."""
    for name in sorted(gathered.unwanted - set(gathered.left_out)):
        raise FitError(f"no press is named '{name}' to be left out; {suggestion(name, gathered.names)}")


def named_presses(
    pictures: Mapping[str, NDArray[np.uint8]],
    profile: SensorProfile,
    region: Region,
    *,
    no_contact: Sequence[NDArray[np.uint8]] = (),
) -> NominalPresses:
    """The same from at least one picture in memory, uint8 (h, w, 3) RGB in the profile's size, by their names."""
    gathered = _Gathered(profile, region)
    for picture in no_contact:
        gathered.add_free(picture)
    contact = _contacts(no_contact)
    for name, picture in pictures.items():
        gathered.add(picture, name, specimen_of(Path(name)), contact(picture))
    return gathered.presses()


def specimen_of(path: Path) -> str | None:
    """The piece in a file's name, None for a name without one."""
    name = numbered(path.stem)
    return name.specimen if name else None


def _read_recording(folder: Path, gathered: _Gathered) -> None:
    """Every press that settles, and the free gel before each."""
    recording, finder = Recording.open(folder), PressFinder(gathered.profile)
    specimens: dict[int, object] = {}
    for recorded in recording:
        specimens[recorded.frame.sequence] = (recorded.label or {}).get("specimen")
        for found in finder.feed(recorded.frame):
            if isinstance(found, FoundPress):
                _add_settled(folder, found, specimens[found.frame.sequence], gathered)
            else:
                gathered.add_free(decode(found.frame, gathered.profile).rgb)
    if finder.detector.newest is None:
        gathered.refused.append(why_unread(folder, recording, finder.detector))
    gathered.faults += _incomplete(recording, finder.settled, finder.detector)


def _incomplete(recording: Recording, settled: int, detector: PressDetector) -> list[str]:
    """The parts of a recording that cannot be learnt. settled: presses found in it."""
    name, held, found = recording.folder.name, recording.presses(), []
    if recording.is_cut:
        found.append(f"recording {name} ends within a line of its index: what came later is not learnt")
    if detector.corrupt:
        found.append(
            f"{detector.corrupt} of {len(recording)} frames of recording {name} cannot be read; the first: "
            f"{detector.first_fault}"
        )
    if held is not None and held != settled:
        found.append(f"recording {name} has labels of {held} presses, and {settled} were found in it")
    return found


def why_unread(folder: Path, recording: Recording, detector: PressDetector) -> str:
    """Why no frame of a recording was looked at."""
    if detector.first_fault is None:
        return f"{folder} has no frames"
    return f"all {detector.corrupt} frames of {folder} were refused; the first: {detector.first_fault}"


def _add_settled(folder: Path, found: FoundPress, specimen: object, gathered: _Gathered) -> None:
    contact = None if found.mask is None or found.relief is None else _Contact(found.mask, found.relief)
    gathered.add(
        decode(found.frame, gathered.profile).rgb,
        f"{folder.name}#{found.frame.sequence}",
        None if specimen is None else str(specimen),
        contact,
    )


def listed_pictures(sources: Sequence[Path], pattern: str | None = None) -> list[Path]:
    """Picture files, and those directly inside folders (or that match the pattern), in the order of their names."""
    check_present(sources)
    files: list[Path] = []
    for source in sources:
        if source.is_dir() and pattern is not None:
            files += images_in(source, pattern)
        elif source.is_dir():
            found = sorted(p for p in source.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
            _refuse_strays(source, found)
            if not found:
                raise FitError(
                    f"{source} is neither a recording nor a folder with pictures ({', '.join(SUFFIXES)}) "
                    "directly inside; name the folder that holds them"
                )
            files += found
        else:
            files.append(source)
    return files


def _refuse_strays(folder: Path, found: Sequence[Path]) -> None:
    """One picture next to folders of pictures is a free gel or a plot, not the presses. Errors: FitError."""
    below = (
        sum(1 for path in folder.rglob("*/*") if path.suffix.lower() in SUFFIXES) if len(found) == 1 else 0
    )
    if below > 1:
        raise FitError(
            f"{folder} has one picture directly inside, {found[0].name}, and {below} in folders below; choose with "
            "--pattern, such as --pattern '*/press.png', and give a picture of the free gel with --no-contact"
        )


def _pictures(
    files: Sequence[Path], profile: SensorProfile, resize: bool
) -> list[tuple[Path, NDArray[np.uint8]]]:
    faults: list[str] = []
    found: list[tuple[Path, NDArray[np.uint8]]] = []
    for path in files:
        try:
            found.append((path, lit(path, read_rgb(path, profile, resize=resize))))
        except DatasetError as error:
            faults.append(str(error))
    if faults:
        raise DatasetError(
            f"{len(faults)} of {len(files)} pictures cannot be used; repair or remove:\n  "
            + "\n  ".join(faults)
        )
    return found


def lit(path: Path, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The same picture. Errors: DatasetError for a black picture."""
    level = float(picture.mean(dtype=np.float64))
    if level < BLACK_LEVEL:
        raise DatasetError(
            f"{path}: is black: its mean level is {level:.1f}, at least {BLACK_LEVEL:g} is expected"
        )
    return picture


def _view(picture: NDArray[np.uint8]) -> View:
    return np.asarray(cv2.resize(picture, VIEW_SIZE, interpolation=cv2.INTER_AREA), np.float32)


def _contacts(free: Sequence[NDArray[np.uint8]]) -> Callable[[NDArray[np.uint8]], _Contact | None]:
    """How a picture's contact is found, as the gateway finds it; none is known without the free gel."""
    if not free:
        return lambda picture: None
    mean = np.stack([_view(picture) for picture in free]).mean(axis=0, dtype=np.float64)
    reference = Reference(np.asarray(mean, np.float32), len(free), 0)
    structure = ReliefOfReference(reference.view)

    def contact(picture: NDArray[np.uint8]) -> _Contact:
        difference = reference.difference(_view(picture))
        relief = structure.of(difference, ContactSettings.light_levels)
        mask = with_relief(touched_mask(difference), relief, ContactSettings.on_area)
        return _Contact(mask, relief.area)

    for picture in free:  # from these it learns the noise: a part that fills the view has structure all over
        contact(picture)
    return contact


def touched_union(
    masks: Sequence[NDArray[np.bool_]], profile: SensorProfile, region: Region
) -> NDArray[np.bool_]:
    """What presses touch in the region, bool (h, w), with a margin. masks: of the view, bool (120, 160) each."""
    union = np.logical_or.reduce(masks)
    seen = touched_in(union, profile.size, region).astype(np.uint8)
    side = 2 * round(TOUCHED_MARGIN_MM * profile.pixels_per_mm) + 1
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.dilate(seen, margin), np.bool_)


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.name}"
