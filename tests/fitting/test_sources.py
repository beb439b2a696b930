"""The sources of `fit`: datasets are resolved to the nominal presses of one part and position."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_recordings import write_recording

from calibration.dataset import open_dataset
from calibration.fitting.command import choose_profile
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.presses.sources import Sources, find_sources
from edge.core.errors import ConfigError, DatasetError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


def picture(path: Path, value: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((240, 320, 3), value, np.uint8))
    return path


def press(root: Path, part: str, position: str, specimen: int, number: int, fault: bool = False) -> Path:
    name = f"{part}_{position}_s{specimen:03d}_p{number:02d}.png"
    home = root / part / position / ("fault" if fault else "")
    if fault:
        picture(home / "mask_320x240" / name, 255)
    return picture(home / "rgb_320x240" / name, 40 + 10 * specimen + number)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """PZ1 at two positions, PZ2 at one; five specimens of two presses, and a damaged one at each."""
    root = tmp_path / "dataset"
    for part, position in (("PZ1", "left"), ("PZ1", "right"), ("PZ2", "left")):
        for specimen in range(5):
            for number in (1, 2):
                press(root, part, position, specimen, number)
        press(root, part, position, 9, 1, fault=True)
    return root


def found(given: Path, part: str | None = None, position: str | None = None, **more: float) -> Sources:
    return find_sources([given], part, position, PROFILE.size, **more)  # type: ignore[arg-type]


def test_the_nominal_presses_of_one_part_and_position(root: Path) -> None:
    """Ten sound presses with the dataset's own specimens; the damaged one is not learnt. A single remaining
    part or position needs no name."""
    sources = found(root, "PZ1", "right")
    presses = read_presses(sources.paths, PROFILE, REGION, specimens=sources.specimens)

    assert (sources.part, sources.position, sources.held_out) == ("PZ1", "right", ())
    assert len(presses) == 10
    assert set(presses.specimens) == {f"PZ1_s00{k}" for k in range(5)}
    assert sorted(presses.frames[:, 0, 0, 0].tolist()) == [40 + 10 * s + n for s in range(5) for n in (1, 2)]
    assert (found(root, "PZ2").position, found(root, position="right").part) == ("left", "PZ1")


@pytest.mark.parametrize(
    ("part", "position", "what"),
    [
        (None, None, "several of */*"),
        ("PZ1", None, "several of PZ1/*"),
        ("PZ3", None, "no nominal press of PZ3/*"),
        ("PZ2", "right", "no nominal press of PZ2/right"),
    ],
)
def test_a_choice_of_none_or_several_lists_what_there_is(
    root: Path, part: str | None, position: str | None, what: str
) -> None:
    """Missing and ambiguous names are refused with every part and position of the dataset."""
    listed = "choose with --part and --position among PZ1/left, PZ1/right, PZ2/left"
    with pytest.raises(DatasetError, match=f"{re.escape(what)}; {listed}"):
        found(root, part, position)


def test_held_out_specimens_are_whole_and_not_learnt(root: Path) -> None:
    """Two of five specimens are kept apart with all their presses, the same two for the same seed."""
    sources = found(root, "PZ1", "left", holdout=0.4, seed=3)

    assert len(sources.held_out) == 2
    assert len(sources.paths) == 6
    assert not {sources.specimens[path] for path in sources.paths} & set(sources.held_out)
    assert found(root, "PZ1", "left", holdout=0.4, seed=3) == sources


def test_several_datasets_are_learnt_together(root: Path, tmp_path: Path) -> None:
    """Two datasets of one part give their presses together; a recording or a picture with them is kept as given."""
    other = tmp_path / "other"
    shutil.copytree(root / "PZ2", other / "PZ2")
    single = picture(tmp_path / "single.png", 7)
    sources = find_sources([root, other, single], "PZ2", None, PROFILE.size)

    assert len(sources.paths) == 21
    assert sources.paths[0] == single


def test_mvtec_folders_are_learnt_by_their_category(tmp_path: Path) -> None:
    """The part is the category, the position the half that its authors made."""
    for half in ("train", "test"):
        for k in range(3):
            picture(tmp_path / "screw" / half / "good" / f"{k:03d}.png", k)
    sources = found(tmp_path, position="train")

    assert (sources.part, sources.position) == ("screw", "train")
    assert {path.parts[-3:-1] for path in sources.paths} == {("train", "good")}


def test_sources_that_are_no_dataset_need_a_part(tmp_path: Path) -> None:
    """A folder of pictures has no part name and no specimens to hold out."""
    picture(tmp_path / "good" / "a.png", 1)

    assert found(tmp_path / "good", "bolt") == Sources("bolt", "default", (tmp_path / "good",))
    with pytest.raises(ConfigError, match="--part is missing"):
        found(tmp_path / "good")
    with pytest.raises(ConfigError, match="no source is a dataset"):
        found(tmp_path / "good", "bolt", holdout=0.2)


@pytest.mark.parametrize("name", ["", " ", "a\nb", "a\x1b[2J", "x" * 129])
@pytest.mark.parametrize("option", ["--part", "--position"])
def test_a_name_that_no_bundle_may_have_is_refused_before_the_fit(
    tmp_path: Path, option: str, name: str
) -> None:
    """Names stand in manifests, logs and results; an empty position is the usual one."""
    picture(tmp_path / "good" / "a.png", 1)

    if (option, name) == ("--position", ""):
        assert found(tmp_path / "good", "bolt", name).position == "default"
        return
    with pytest.raises(ConfigError, match=f"{option} is a name of 1 to 128 characters"):
        found(tmp_path / "good", *(("bolt", name) if option == "--position" else (name, None)))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff"])
def test_fit_and_evaluate_see_the_same_pixels(tmp_path: Path, suffix: str) -> None:
    """A picture of a dataset is learnt and scored from equal pixels, in any format."""
    rng = np.random.default_rng(0)
    pixels = cv2.GaussianBlur(rng.integers(0, 256, (240, 320, 3), dtype=np.uint8), (0, 0), 3)
    for half in ("train", "test"):
        path = tmp_path / "screw" / half / "good" / f"a{suffix}"
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), pixels)
    sources = found(tmp_path, position="train")
    learnt = read_presses(sources.paths, PROFILE, REGION).frames[0]
    (scored,) = open_dataset(tmp_path).select("screw", "test").presses

    assert scored.size == PROFILE.size
    assert (REGION.crop(scored.rgb()) == learnt).all()


def test_the_folder_of_an_acquisition_is_read_with_its_free_gel(tmp_path: Path) -> None:
    """`gelgate bundle learn` and the others take the folder that `gelgate new-part` keeps, beside its coverage.png."""
    picture(tmp_path / "coverage.png", 9)
    for number in range(3):
        picture(tmp_path / "free" / f"free_{number}.png", 90)
        picture(tmp_path / "presses" / f"bolt-default_s00{number}_p01.png", 100 + 20 * number)
    (tmp_path / "acquisition.json").write_text('{"version": 1, "profile": "cropped_lr"}')

    presses = read_presses([tmp_path], PROFILE, REGION)

    assert presses.names == tuple(f"presses/bolt-default_s00{number}_p01.png" for number in range(3))
    assert not presses.estimated
    assert presses.no_contact is not None
    assert set(presses.no_contact.ravel().tolist()) == {90}
    assert choose_profile("", [tmp_path]).name == "cropped_lr"


@pytest.mark.parametrize(("size", "profile_name"), [((320, 240), "cropped_lr"), ((64, 48), "mini_lr")])
def test_a_recording_that_names_no_profile_has_that_of_its_frames(
    tmp_path: Path, size: tuple[int, int], profile_name: str
) -> None:
    """As `gelgate record` counts its presses; mini_lr where none is of this size."""
    assert choose_profile("", [write_recording(tmp_path / "take", 2, size=size)]).name == profile_name
