"""Nominal presses from the user's sources: recordings, folders of pictures, single pictures.

From a recording the contact tracker takes the settled frame of every press, exactly like the gateway, and frames of the
free gel. Each picture is a press. The free gel of pictures is given, or estimated from them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from calibration.dataset.files import read_rgb
from calibration.dataset.press import numbered
from calibration.fitting.presses.free_gel import measure_strengths, view_of
from calibration.fitting.presses.gel_choice import MIN_PRESSES, choose_free_gel, contact_finder
from calibration.fitting.presses.recorded_presses import FoundPress, PressFinder
from calibration.fitting.presses.sources import is_acquisition, list_pictures, name_apart, name_unread
from calibration.fitting.presses.strangers import find_odd, find_pieces, merge_copies, small_view
from edge.core.arrays import U8, Mask
from edge.core.contact.mask import Touch, touched
from edge.core.contact.press_detector import PressDetector
from edge.core.errors import DatasetError, FitError
from edge.core.imaging.decode import decode
from edge.core.imaging.marker_dots import MarkerDots
from edge.core.imaging.quality import BLACK_LEVEL
from edge.core.imaging.region import Region, touched_in
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.suggest import suggestion
from edge.recording.format import HEADER, Recording

__all__ = [
    "MIN_PRESSES",
    "NominalPresses",
    "gather_presses",
    "is_recording",
    "read_presses",
    "require_light",
    "specimen_of",
    "touched_union",
    "why_unread",
]

# Frames of the free gel that are kept: the detectors need only its mean and its noise.
MAX_NO_CONTACT = 16

# A new press is slightly off the old ones: one tenth of a gel's useful width (18.6 mm, datasheet) is 1.9 mm.
TOUCHED_MARGIN_MM = 1.0


_Mask = Mask | None
"""Where a press touches in the view, bool (120, 160); None where the free gel is not known."""
# The fields with one entry per press.
_EACH = ("names", "specimens", "touches", "strengths", "guessed")


@dataclass(frozen=True)
class NominalPresses:
    """Nominal presses of one position, cut to the inspected region."""

    frames: U8
    """Pictures, uint8 (n, h, w, 3) RGB."""
    names: tuple[str, ...]
    specimens: tuple[str | None, ...] = ()
    """The piece of each press, None where it is unknown."""
    touches: tuple[Touch, ...] = ()
    """Area and centroid in the picture, empty when there is no free gel to compare with."""
    strengths: tuple[float, ...] = ()
    """Of their imprints, levels; empty where the free gel was not seen."""
    guessed: tuple[Touch, ...] = ()
    """The same by an estimate of the free gel that is in doubt: good for a warning alone."""
    touched: Mask | None = None
    """What the presses touch with a margin of 1 mm, bool (h, w); None where the free gel was not seen."""
    no_contact: U8 | None = None
    """The free gel, uint8 (m, h, w, 3); None where it is in doubt."""
    left_out: tuple[str, ...] = ()
    """Names of presses found and left out."""
    free_view: U8 | None = None
    """The free gel as contact detection sees it, uint8 (120, 160, 3)."""
    faults: tuple[str, ...] = ()
    """Parts of the sources that could not be read or found, and doubts about the free gel, a sentence each."""
    estimated: str = ""
    """How the free gel was estimated from the presses; empty where it was seen."""
    film: tuple[int, ...] = ()
    """The presses in their order, where they are frames of one film."""
    dots: MarkerDots | None = None
    """The dots of a marker gel, filled in the pictures; None where they are none, or are not filled."""
    raw: U8 | None = None
    """The pictures before they were smoothed, (n, h, w, 3); None where they are not smoothed."""
    unjudged: Mask | None = None
    """Places at which a station did not judge them, as under scars of its gel, (n, h, w); None for none."""

    def __post_init__(self) -> None:
        if self.frames.ndim != 4 or self.frames.shape[3] != 3 or self.frames.dtype != np.uint8:
            raise ValueError(f"frames are uint8 (n, h, w, 3), found {self.frames.dtype} {self.frames.shape}")
        if not self.specimens:
            object.__setattr__(self, "specimens", (None,) * len(self.frames))
        for what in (getattr(self, name) for name in _EACH):
            if what and len(what) != len(self.frames):
                raise ValueError(f"{len(self.frames)} frames with {len(what)} names, specimens or touches")

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def facts(self) -> dict[str, str]:
        """What the manifest says of the free gel."""
        sentences = {"free_gel": self.estimated, "dots": "" if self.dots is None else str(self.dots)}
        return {name: sentence for name, sentence in sentences.items() if sentence}

    def first(self, count: int) -> "NominalPresses":
        """Return the first ones."""
        return self.choose(range(min(count, len(self))))

    def choose(self, rows: Sequence[int]) -> "NominalPresses":
        """Return these presses alone."""
        kept = {name: tuple(getattr(self, name)[k] for k in rows if getattr(self, name)) for name in _EACH}
        frames, raw, unjudged = (
            None if each is None else each[list(rows)] for each in (self.frames, self.raw, self.unjudged)
        )
        return replace(self, frames=frames, raw=raw, unjudged=unjudged, film=(), **kept)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _Press:
    """A press found in the sources."""

    rgb: U8
    """The inspected region."""
    name: str
    specimen: str | None
    mask: _Mask
    view: U8
    """The whole picture, uint8 (120, 160, 3)."""


@dataclass
class _Gathered:
    """What is found while sources are read."""

    profile: SensorProfile
    region: Region
    unwanted: frozenset[str] = frozenset()
    presses: list[_Press] = field(default_factory=list)
    free: list[U8] = field(default_factory=list)
    """Whole pictures of the free gel, until it is chosen those of recordings."""
    left_out: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    estimated: str = ""
    is_doubtful: bool = False
    film: tuple[int, ...] = ()

    def choose_gel(self, pictures: Sequence[U8], given: Mapping[str, U8]) -> None:
        """Choose the free gel by the presses of pictures, from given pictures, recordings or the presses."""
        chosen = choose_free_gel(pictures, given, self.free, self.profile)
        self.free, self.estimated, self.is_doubtful = chosen.pictures, chosen.estimated, chosen.is_doubtful
        self.faults += chosen.faults

    def add(self, picture: U8, name: str, specimen: str | None, mask: _Mask) -> None:
        if name in self.unwanted:
            self.left_out.append(name)
        else:
            self.presses.append(
                _Press(self.region.crop(picture).copy(), name, specimen, mask, small_view(picture))
            )

    def finish(self) -> NominalPresses:
        """Return all presses; their contacts count where every one is known, by a free gel without doubt."""
        presses, free = self.presses, self.free[:MAX_NO_CONTACT]
        known = [None if self.is_doubtful else press.mask for press in presses]
        names, frames, views = zip(*((press.name, press.rgb, press.view) for press in presses), strict=True)
        masks = [press.mask for press in presses if press.mask is not None]
        touches = tuple(touched(mask) for mask in masks) if len(masks) == len(presses) else ()
        light, is_seen = [view_of(picture) for picture in free], bool(touches) and not self.estimated
        return NominalPresses(
            frames=np.stack(frames),
            names=names,
            specimens=tuple(merge_copies(frames, names, [press.specimen for press in presses])),
            touches=() if self.is_doubtful else touches,
            strengths=measure_strengths(views, np.mean(light, axis=0)) if is_seen else (),
            guessed=touches if self.is_doubtful else (),
            touched=touched_union(masks, self.profile, self.region) if is_seen else None,
            no_contact=np.stack([self.region.crop(picture) for picture in free])
            if free and not self.is_doubtful
            else None,
            left_out=tuple(self.left_out),
            free_view=np.rint(np.mean(light, axis=0, dtype=np.float64)).astype(np.uint8)
            if free and not self.estimated
            else None,
            faults=(*find_odd(names, frames, views, known), *self.faults),
            estimated=self.estimated,
            film=self.film,
        )


def is_recording(source: Path) -> bool:
    """Tell whether a folder is a recording rather than a folder of pictures."""
    return (source / HEADER).is_file()


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
    """Read the nominal presses of all sources together: recordings, folders of pictures, or pictures.

    A picture has the camera's size (it is cut and scaled as the profile says) or the profile's own; resize allows any
    other, cut to the profile's aspect. pattern: which files of a folder, those below it too; None: those directly
    inside. no_contact: pictures, or folders of them, of the free gel; None: those of acquisitions. specimens: of
    pictures, where their names do not have it. leave_out: names of presses to leave out, as a bundle lists them.
    Errors: RecordingError, DatasetError listing every faulty picture, FitError when there is no press, or no press of a
    name to leave out.
    """
    gathered = _Gathered(profile, region, unwanted=frozenset(leave_out or ()))
    acquired = [source / "free" for source in sources if is_acquisition(source)]
    free_files = list_pictures(no_contact or [folder for folder in acquired if any(folder.iterdir())])
    free = _pictures(free_files, profile, resize)
    recordings = [source for source in sources if is_recording(source)]
    for source, name in zip(recordings, name_apart(recordings, 1), strict=True):
        _read_recording(source, name, gathered)
    others = [source for source in sources if not is_recording(source)]
    files = list_pictures(others, pattern)
    unread = name_unread(others, [*files, *free_files]) if pattern is None else []
    given_twice = [path for path in files if any(path.samefile(one) for one in free_files)]
    if files and given_twice == files:
        raise FitError(
            "every picture of the presses is given as one of the free gel too; leave them out of one"
        )
    files = [path for path in files if path not in given_twice]
    pictures = _pictures(files, profile, resize)
    names = name_apart([path for path, _ in pictures], 2)
    kept = [k for k, name in enumerate(names) if name not in gathered.unwanted]
    free_names = name_apart([path for path, _ in free], 2)
    given = {name: picture for name, (_, picture) in zip(free_names, free, strict=True)}
    gathered.choose_gel([pictures[k][1] for k in kept], given)
    # Presses of a recording were made one by one, and a robot may repeat them well.
    pieces = [specimens.get(path) or specimen_of(path) for path, _ in pictures]
    same, pieces, film = find_pieces(names, [small_view(picture) for _, picture in pictures], pieces)
    gathered.film = () if gathered.presses else tuple(kept.index(k) for k in film if k in kept)
    gathered.faults += [*same, *_name_pages([*files, *free_files]), *unread]
    contact = _contacts(gathered.free)
    for name, piece, (_, picture) in zip(names, pieces, pictures, strict=True):
        gathered.add(picture, name, piece, contact(picture))
    _require_left_out(gathered)
    if not gathered.presses and gathered.refused:
        raise FitError("no press was found: " + "; ".join(gathered.refused))
    if not gathered.presses:
        raise FitError(
            f"no press was found in {', '.join(map(str, sources)) or 'no source'}; give a recording with presses or a "
            "folder of pictures"
        )
    return gathered.finish()


def _require_left_out(gathered: _Gathered) -> None:
    """Refuse a name to leave out that no press has, or several have. Errors: FitError."""
    for name in sorted(gathered.unwanted - set(gathered.left_out)):
        known = [press.name for press in gathered.presses]
        if alike := [one for one in known if one.endswith(f"/{name}")]:
            raise FitError(f"several presses are named '{name}'; say which is left out: {', '.join(alike)}")
        raise FitError(f"no press is named '{name}' to be left out; {suggestion(name, known)}")


def gather_presses(
    pictures: Mapping[str, U8],
    profile: SensorProfile,
    region: Region,
    *,
    no_contact: Sequence[U8] = (),
) -> NominalPresses:
    """Gather presses from one picture or more in memory, uint8 (h, w, 3) RGB in the profile's size, by their names."""
    gathered = _Gathered(profile, region)
    gathered.free += no_contact
    contact = _contacts(no_contact)
    for name, picture in pictures.items():
        gathered.add(picture, name, specimen_of(Path(name)), contact(picture))
    return gathered.finish()


def specimen_of(path: Path) -> str | None:
    """The piece in a file's name, None for a name without one."""
    name = numbered(path.stem)
    return name.specimen if name else None


def _read_recording(folder: Path, name: str, gathered: _Gathered) -> None:
    """Every press that settles, and the free gel before each. name: of the recording, in the names of its presses."""
    recording, finder = Recording.open(folder), PressFinder(gathered.profile)
    specimens: dict[int, object] = {}
    for recorded in recording:
        specimens[recorded.frame.sequence] = (recorded.label or {}).get("specimen")
        for press_or_free in finder.feed(recorded.frame):
            if isinstance(press_or_free, FoundPress):
                number, rgb = press_or_free.frame.sequence, decode(press_or_free.frame, gathered.profile)
                piece = None if specimens[number] is None else str(specimens[number])
                gathered.add(rgb, f"{name}#{number}", piece, press_or_free.mask)
            elif len(gathered.free) < MAX_NO_CONTACT:
                gathered.free.append(decode(press_or_free, gathered.profile))
    if finder.detector.newest is None:
        gathered.refused.append(why_unread(folder, finder.detector))
    gathered.faults += _incomplete(recording, finder.settled, finder.detector)


def _incomplete(recording: Recording, settled: int, detector: PressDetector) -> list[str]:
    """The parts of a recording that cannot be learnt. settled: presses found in it."""
    name, held, sentences = recording.folder.name, recording.presses(), []
    if recording.is_cut:
        sentences.append(f"recording {name} ends within a line of its index: what came later is not learnt")
    if detector.corrupt:
        sentences.append(
            f"{detector.corrupt} of {len(recording)} frames of recording {name} cannot be read; the first: "
            f"{detector.first_fault}"
        )
    if held is not None and held != settled:
        sentences.append(f"recording {name} has labels of {held} presses, and {settled} were found in it")
    return sentences


def why_unread(folder: Path, detector: PressDetector) -> str:
    """Say why no frame of a recording was looked at."""
    if detector.first_fault is None:
        return f"{folder} has no frames"
    return f"all {detector.corrupt} frames of {folder} were refused; the first: {detector.first_fault}"


def _pictures(files: Sequence[Path], profile: SensorProfile, resize: bool) -> list[tuple[Path, U8]]:
    faults: list[str] = []
    pictures: list[tuple[Path, U8]] = []
    for path in files:
        try:
            pictures.append((path, require_light(path, read_rgb(path, profile, resize=resize))))
        except DatasetError as error:
            faults.append(str(error))
    whys = {fault.partition(": ")[2] for fault in faults}
    if len(faults) == len(files) > 1 and len(whys) == 1:
        raise DatasetError(f"none of the {len(files)} pictures can be used; each {whys.pop()}")
    if faults:
        raise DatasetError(
            f"{len(faults)} of {len(files)} pictures cannot be used; repair or remove:\n  "
            + "\n  ".join(faults)
        )
    return pictures


def _name_pages(files: Sequence[Path]) -> list[str]:
    """Name the files with further pages, of which the first alone is read."""
    paged = [
        path for path in files if path.suffix.lower() in (".tif", ".tiff") and cv2.imcount(str(path)) > 1
    ]
    if not paged:
        return []
    return [
        f"{len(paged)} of {len(files)} pictures have further pages, which are not read ('{paged[0]}' has "
        f"{cv2.imcount(str(paged[0]))}): save each page as a picture of its own"
    ]


def require_light(path: Path, picture: U8) -> U8:
    """Return the picture. Errors: DatasetError for a black one."""
    level = float(picture.mean(dtype=np.float64))
    if level < BLACK_LEVEL:
        raise DatasetError(
            f"{path}: is black: its mean level is {level:.1f}, at least {BLACK_LEVEL:g} is expected"
        )
    return picture


def _contacts(free: Sequence[U8]) -> Callable[[U8], _Mask]:
    """Return the function that finds a picture's contact as the gateway does; none is known without the free gel."""
    if not free:
        return lambda picture: None
    find = contact_finder(free)
    return lambda picture: find(picture).mask


def touched_union(masks: Sequence[Mask], profile: SensorProfile, region: Region) -> Mask:
    """Unite what presses touch in the region, bool (h, w), with a margin. masks: of the view, bool (120, 160) each."""
    union = np.logical_or.reduce(masks)
    seen = touched_in(union, profile.size, region).astype(np.uint8)
    side = 2 * round(TOUCHED_MARGIN_MM * profile.pixels_per_mm) + 1
    margin = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return np.asarray(cv2.dilate(seen, margin), np.bool_)
