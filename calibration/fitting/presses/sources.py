"""The sources of `fit` and `wrap`: recordings, folders of pictures, pictures, and the nominal presses of datasets."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calibration.dataset import (
    Dataset,
    LabelledPress,
    layout_of,
    open_dataset,
    resolution_of,
    split_by_specimen,
)
from calibration.dataset.files import SUFFIXES
from edge.core.errors import ConfigError, DatasetError, FitError
from edge.model.manifest_files import LONGEST_NAME
from edge.recording.format import FRAMES, HEADER
from edge.recording.from_images import images_in

__all__ = [
    "ACQUISITION",
    "DEFAULT_POSITION",
    "Sources",
    "check_name",
    "check_present",
    "choose_position",
    "find_sources",
    "is_acquisition",
    "is_dataset",
    "list_pictures",
    "name_apart",
    "name_unread",
]

DEFAULT_POSITION = "default"

ACQUISITION = "acquisition.json"
"""In a folder of `gelgate bundle acquire`, beside its folders `presses` and `free`."""

# Files that a person takes for pictures too.
_UNREAD_SUFFIXES = (".webp", ".gif", ".heic", ".heif", ".avif", ".jp2", ".npy", ".raw")


@dataclass(frozen=True)
class Sources:
    """The sources of nominal presses, with their part and position."""

    part: str
    position: str
    paths: tuple[Path, ...]
    """Recordings, folders of pictures, and single pictures."""
    specimens: Mapping[Path, str | None] = field(default_factory=dict)
    """The specimen of each picture of a dataset."""
    held_out: tuple[str, ...] = ()
    """The specimens of a dataset that are kept for its evaluation."""

    def __post_init__(self) -> None:
        check_name("--part", self.part)
        check_name("--position", self.position)


def check_name(option: str, name: str) -> None:
    """Check a name that results, logs and files carry. Errors: ConfigError, before any work."""
    if not (0 < len(name) <= LONGEST_NAME and name.isprintable() and name.strip()):
        raise ConfigError(
            f"{option} is a name of 1 to {LONGEST_NAME} characters without control characters, found "
            f"{name[:LONGEST_NAME]!r}; give another"
        )


def is_dataset(source: Path) -> bool:
    """Tell whether a source is a folder in the layout of a dataset, so that it knows parts and positions itself."""
    return source.is_dir() and layout_of(source) is not None


def is_acquisition(source: Path) -> bool:
    """Tell whether a source is a folder that `gelgate bundle acquire` or `gelgate new-part` has filled."""
    return (source / ACQUISITION).is_file()


def check_present(sources: Sequence[Path]) -> None:
    """Check that the sources exist. Errors: FitError for the first that is not there."""
    for source in sources:
        if not source.exists():
            raise FitError(f"there is nothing at {source}; check the path")


def find_sources(
    given: Sequence[Path],
    part: str | None,
    position: str | None,
    size: tuple[int, int],
    *,
    holdout: float = 0.0,
    seed: int = 0,
) -> Sources:
    """Replace datasets among the sources by their nominal presses of one part and position.

    part, position: optional for a dataset that holds only one. size: (width, height) of the profile's pictures, which
    chooses the resolution of the paper's layout. holdout: the share of each dataset's presses that is kept for
    evaluation, complete specimens at a time, drawn by the seed. Errors: ConfigError for a missing name, DatasetError
    with the known names where part and position choose none or several.
    """
    datasets = [open_dataset(path, resolution_of(size)) for path in given if is_dataset(path)]
    roots = {dataset.root for dataset in datasets}
    others = tuple(path for path in given if path not in roots)
    if not datasets:
        if part is None:
            raise ConfigError("--part is missing: name the part that is pressed")
        if holdout:
            raise ConfigError("--holdout divides a dataset by its specimens, and no source is a dataset")
        return Sources(part, position or DEFAULT_POSITION, others)
    part, position = choose_position(datasets, part, position)
    kept: list[LabelledPress] = []
    held_out: set[str] = set()
    for dataset in datasets:
        presses = dataset.select(part, position).good
        if holdout:
            split = split_by_specimen(presses, holdout, seed)
            presses, held_out = split.kept, held_out | {str(press.specimen) for press in split.held_out}
        kept += presses
    return Sources(
        part,
        position,
        (*others, *(press.path for press in kept)),
        {press.path: press.specimen for press in kept},
        tuple(sorted(held_out)),
    )


def choose_position(datasets: Sequence[Dataset], part: str | None, position: str | None) -> tuple[str, str]:
    """Return the part and position for which all datasets have nominal presses. Errors: DatasetError with the known
    names."""
    for dataset in datasets:
        known = sorted({(press.part, press.position) for press in dataset.good})
        chosen = [pair for pair in known if part in (None, pair[0]) and position in (None, pair[1])]
        if len(chosen) != 1:
            wanted = "/".join(name or "*" for name in (part, position))
            names = ", ".join(map("/".join, known))
            todo = (
                f"choose with --part and --position among {names}" if known else "add pictures of sound parts"
            )
            raise DatasetError(
                f"dataset '{dataset.root}' has {'several of' if chosen else 'no nominal press of'} {wanted}; {todo}"
            )
        part, position = chosen[0]
    assert part is not None
    assert position is not None
    return part, position


def list_pictures(sources: Sequence[Path], pattern: str | None = None) -> list[Path]:
    """List picture files, and those directly inside folders (or that match the pattern), in order of their names."""
    check_present(sources)
    files: list[Path] = []
    for given in sources:
        source = given / "presses" if is_acquisition(given) else given
        if source.is_dir() and pattern is not None:
            files += images_in(source, pattern)
        elif source.is_dir():
            named = sorted(p for p in source.iterdir() if p.suffix.lower() in (*SUFFIXES, *_UNREAD_SUFFIXES))
            pictures = [p for p in named if p.suffix.lower() in SUFFIXES and p.is_file()]
            _refuse_strays(source, pictures)
            if unread := [p.name for p in named if p not in pictures]:
                raise FitError(
                    f"{source} holds what cannot be read as a picture ({', '.join(unread[:8])}): a link to nothing, a "
                    f"folder, or a format other than {', '.join(SUFFIXES)}; save it as one, or move it away"
                )
            if not pictures:
                below = sorted(path for path in source.rglob("*/*") if path.suffix.lower() in SUFFIXES)
                remedy = "name the folder that holds them" + (f", {below[0].parent}" if below else "")
                names = Counter(path.name for path in below)
                if repeated := next((path for path in below if names[path.name] > 1), None):
                    folders = "*/" * (len(repeated.relative_to(source).parts) - 1)
                    remedy = f"choose with --pattern, such as --pattern '{folders}{repeated.name}'"
                raise FitError(
                    f"{source} is neither a recording nor a folder with pictures ({', '.join(SUFFIXES)}) "
                    f"directly inside; {remedy}"
                )
            if source.absolute().name == FRAMES and (source.absolute().parent / HEADER).is_file():
                raise FitError(
                    f"{source} holds all frames of a recording, the free gel among them; name the recording, "
                    f"{source.parent}, in which presses are found"
                )
            files += pictures
        else:
            files.append(source)
    for file in files:
        if not f"{file.parent.name}/{file.name}".isprintable():  # a manifest and sentences name it so
            raise FitError(f"the name {str(file)!a} cannot be printed; rename the file, and its folder")
    return files


def name_unread(sources: Sequence[Path], read: Sequence[Path]) -> list[str]:
    """Name each folder with pictures in folders below it that are not read, with one of them."""
    known, said = set(read), []
    for folder in filter(Path.is_dir, sources):
        below = (path for path in folder.rglob("*/*") if path.suffix.lower() in SUFFIXES)
        if unread := min((path for path in below if path not in known), default=None):
            said.append(
                f"pictures in folders below {folder} are not read, such as {unread}: name their folder too, or choose "
                "with --pattern"
            )
    return said


def name_apart(paths: Sequence[Path], parts: int) -> list[str]:
    """Name paths by so many of their last parts, 1 or 2, and by more where others would have the same name."""
    names = [path.name if parts == 1 else f"{path.parent.name}/{path.name}" for path in paths]
    whole = [path.absolute().parts for path in paths]
    for name in {name for name in names if names.count(name) > 1}:
        alike, more = [k for k, path in enumerate(names) if path == name], parts
        different = len({whole[k] for k in alike})
        while len({whole[k][-more:] for k in alike}) < different:
            more += 1
        for k in alike if different > 1 else ():
            names[k] = "/".join(whole[k][-more:])
    return names


def _refuse_strays(folder: Path, found: Sequence[Path]) -> None:
    """Refuse one picture next to folders of pictures: it is a free gel or a plot. Errors: FitError."""
    below = (
        sum(1 for path in folder.rglob("*/*") if path.suffix.lower() in SUFFIXES) if len(found) == 1 else 0
    )
    if below > 1:
        raise FitError(
            f"{folder} has one picture directly inside, {found[0].name}, and {below} in folders below; choose with "
            "--pattern, such as --pattern '*/press.png', and give a picture of the free gel with --no-contact"
        )
