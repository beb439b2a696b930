"""Scene files: read into frozen values, refused with every fault at once."""

from pathlib import Path

import pytest

from calibration.simulator.scene import SCENES, load_scene, paper_scenes, scene_names
from edge.core.errors import ConfigError

GOOD = """version = 1
name = "mine"
part = "PZ3"
effects = ["noise", "illumination"]

[nominal]
specimens = 2
presses = 3
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_a_scene_is_read_with_the_parts_own_figures(tmp_path: Path) -> None:
    """Settings that the file omits come from the part; effects are kept in the order in which they act."""
    scene = load_scene(written(tmp_path, GOOD))
    assert scene.at == ("pos1", "pos2")
    assert scene.press_depth_mm == 0.4
    assert scene.press_jitter.shift_mm == 0.12
    assert scene.effects == ("illumination", "noise")


def test_every_fault_is_reported_at_once(tmp_path: Path) -> None:
    """Four faults, four lines, each with what was found and the nearest name if there is one."""
    text = GOOD.replace('"noise"', '"nois"').replace("PZ3", "PZ9").replace("specimens = 2", "specimen = 2")
    with pytest.raises(ConfigError) as caught:
        load_scene(written(tmp_path, text + "[camera]\nfps = -3\n"))
    message = str(caught.value)
    assert "5 fault(s)" in message
    assert "did you mean 'noise'?" in message
    assert "no part is named 'PZ9'" in message
    assert "'nominal.specimen' is not known; did you mean 'specimens'?" in message
    assert "'nominal.specimens' is missing" in message
    assert "'camera.fps' is -3" in message


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("version = 1", "version = 2"), "'version' is 2"),
        (("[nominal]\nspecimens = 2\npresses = 3\n", ""), "either [[runs]] (recordings) or [nominal]"),
        (('name = "mine"', 'name = "mine"\npositions = ["pos7"]'), "no position of PZ3 is named 'pos7'"),
        (('name = "mine"', 'name = "mine"\npositions = ["pos1", "pos1"]'), "positions are different"),
        (("[nominal]", "[camera]\nmodes = ['lr', 'lr']\n[nominal]"), "camera modes are different"),
        (("[nominal]", "[defects]\nseverity = [0.9, 0.1]\n[nominal]"), "[least, most]"),
        (("[nominal]", "[camera]\nmodes = ['native']\n[nominal]"), "found native"),
        (('"noise"', '"residual_imprint"'), "'residual_imprint' has no effect; leave it out of `effects`"),
        (("[nominal]", "[defects]\nkinds = ['dents']\n[nominal]"), "did you mean 'dent'?"),
    ],
)
def test_a_wrong_scene_says_what_is_wrong(change: tuple[str, str], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_scene(written(tmp_path, GOOD.replace(*change)))
    assert sentence in str(caught.value)


def test_an_unknown_scene_is_refused_with_the_nearest_name() -> None:
    """'dmeo' was meant to be 'demo'."""
    with pytest.raises(ConfigError, match="did you mean 'demo'"):
        load_scene("dmeo")


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    """Unreadable, missing and faulty files have different errors."""
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scene(written(tmp_path, "version = "))
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scene(tmp_path / "absent.toml")


def test_every_shipped_scene_is_valid_and_begins_with_its_version() -> None:
    """Each file parses and its first line is the version."""
    files = sorted(SCENES.rglob("*.toml"))
    assert len(files) >= 7
    for path in files:
        load_scene(path)
        assert path.read_text().splitlines()[0] == "version = 1"
    assert "demo" in scene_names()


def test_the_paper_scenes_have_the_counts_of_table_one() -> None:
    """Sound and damaged presses per part, and which parts exist at high resolution too."""
    counts = {
        scene.part: (
            scene.nominal.specimens * scene.nominal.presses * len(scene.at),
            scene.defects.images,
            "hr" in scene.camera.modes,
        )
        for scene in paper_scenes()
        if scene.nominal
    }
    assert counts == {
        "PZ1": (1600, 75, False),
        "PZ2": (210, 17, False),
        "PZ3": (260, 24, True),
        "PZ4": (220, 21, True),
        "PZ5": (230, 21, True),
    }
