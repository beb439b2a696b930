"""`gelgate fit`: from a folder of pictures to a verified bundle, with the detector and backbone of another package."""

from pathlib import Path

import cv2
import pytest
import tiny
from typer.main import get_command
from typer.testing import CliRunner, Result

from edge import cli, registry
from edge.core.errors import ConfigError, FitError, GelgateError
from edge.model.bundle import Bundle

pytestmark = pytest.mark.usefixtures("other_package")


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Six nominal pictures of the profile `cropped_lr`, 320x240."""
    folder = tmp_path / "good"
    folder.mkdir()
    for k, frame in enumerate(tiny.presses(6)):
        cv2.imwrite(str(folder / f"{k}.png"), cv2.resize(frame, (320, 240), interpolation=cv2.INTER_NEAREST))
    return folder


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.build(), [str(a) for a in arguments])


def fit(pictures: Path, out: Path, *more: object) -> Result:
    options = ("--part", "bolt", "--method", "tiny", "--backbone", "tiny", "--profile", "cropped_lr")
    return run("fit", pictures, "-o", out, *options, *more)


def test_fit_inspect_verify(pictures: Path, tmp_path: Path) -> None:
    """A method of another package is fitted, inspected and verified; gelgate's source does not name it."""
    result = fit(pictures, tmp_path / "bolt.zip", "--set", "gain=2.5", "--set", "packing='int8'")
    assert result.exit_code == 0, result.output
    for said in ("6 nominal presses, tiny (corrected) on tiny", "1/7", "warning:", "threshold", "written to"):
        assert said in result.output
    manifest = Bundle.load(tmp_path / "bolt.zip").manifest
    assert manifest.parameters == {"gain": 2.5, "packing": "int8"}
    assert (manifest.part, manifest.region.width, manifest.provenance.seed) == ("bolt", 224, 0)
    assert run("bundle", "verify", tmp_path / "bolt.zip").exit_code == 0
    assert "gain=2.5" in run("bundle", "inspect", tmp_path / "bolt.zip").output


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (("--method", "tny"), "did you mean 'tiny'"),
        (("--backbone", "nothing"), "no backbone is named 'nothing'"),
        (("--profile", "croped_lr"), "did you mean 'cropped_lr'"),
        (("--region", "0,0,400x400"), "region"),
        (("--mode", "papr"), "--set mode is corrected or paper, found 'papr'"),
        (("--set", "gain"), "write --set name=value"),
        (("--set", "gian=1"), "have no such parameter; did you mean 'gain'?"),
        (("--set", "folsd=3"), "have no such parameter; did you mean 'folds'?"),
        (("--alpha", "2"), "false-alarm rate"),
        (("--register", "often"), "--set register is auto, never or always, found 'often'"),
        (("--augment", "often"), "--set augment is auto, never or always, found 'often'"),
        (
            ("--augment", "always"),
            "no copies of the presses can be added: they need a picture of the free gel",
        ),
    ],
)
def test_a_wrong_option_is_a_sentence_and_leaves_nothing(
    pictures: Path, tmp_path: Path, more: tuple[str, ...], reason: str
) -> None:
    result = fit(pictures, tmp_path / "bolt", *more)
    assert isinstance(result.exception, GelgateError)
    assert reason in str(result.exception)
    assert not (tmp_path / "bolt").exists()


def test_a_bundle_without_its_trunk_is_found_through_the_installed_backbone(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--no-trunk` leaves it out; the installed backbone of that name, complete or cut, supplies it by its hash."""
    # The child process of the first run does not know the backbone that this test has installed.
    monkeypatch.setattr("edge.cli.bundles.try_bundle", lambda *arguments: None)
    assert fit(pictures, tmp_path / "bolt", "--no-trunk").exit_code == 0
    assert not (tmp_path / "bolt" / "trunk.onnx").exists()
    assert run("bundle", "verify", tmp_path / "bolt").exit_code == 0


def test_a_press_is_left_out_by_name(pictures: Path, tmp_path: Path) -> None:
    """It is not learnt, and the bundle says that it was there; one that is not there is refused with the nearest."""
    refused = fit(pictures, tmp_path / "bolt", "--leave-out", "good/9.png", "--leave-out", "good/1.png")
    assert isinstance(refused.exception, GelgateError)
    assert "no press is named 'good/9.png'" in str(refused.exception)
    assert "did you mean 'good/" in str(refused.exception)
    assert not (tmp_path / "bolt").exists()
    assert fit(pictures, tmp_path / "bolt", "--leave-out", "good/3.png").exit_code == 0
    origin = Bundle.load(tmp_path / "bolt").manifest.provenance
    assert origin.presses == tuple(f"good/{k}.png" for k in (0, 1, 2, 4, 5))
    assert origin.left_out == ("good/3.png",)


def test_a_bundle_is_replaced_when_asked_and_has_the_next_revision(pictures: Path, tmp_path: Path) -> None:
    """A station then knows which of two bundles is older; a number that is given is used."""
    found = []
    for options in ((), ("--overwrite",), ("--overwrite", "--revision", "9"), ("--overwrite",)):
        assert fit(pictures, tmp_path / "bolt", *options).exit_code == 0
        found.append(Bundle.load(tmp_path / "bolt").manifest.revision)

    assert found == [1, 2, 9, 10]
    assert isinstance(fit(pictures, tmp_path / "bolt").exception, ConfigError)
    assert Bundle.load(tmp_path / "bolt").manifest.revision == 10


def test_the_default_is_the_backbone_for_real_touch(pictures: Path, tmp_path: Path) -> None:
    """Without --backbone, and by a free gel that is only estimated."""
    small = ("--region", "112,72,96x96", "--threshold", "9", "--profile", "cropped_lr", "--scattered")
    result = run("fit", pictures, "-o", tmp_path / "bolt", "--part", "bolt", *small)
    assert result.exit_code == 0, result.output
    assert "free gel: estimated from 6 presses" in result.output
    assert "padim (corrected) on tactile_lite0" in result.output
    assert Bundle.load(tmp_path / "bolt").manifest.backbone.id == "tactile_lite0"


def test_the_help_shows_twelve_options_and_set_gives_the_rest(pictures: Path, tmp_path: Path) -> None:
    """What is under `--set` is read as its own option is, which still works; the manual lists it."""
    options = [one for one in get_command(cli.build()).commands["fit"].params if one.name != "sources"]
    under_set = [one.name for one in options if one.hidden]
    page = (Path(__file__).parents[2] / "docs/parameters.md").read_text(encoding="utf-8")
    old = fit(pictures, tmp_path / "old", "--seed", 3, "--folds", 3, "--no-trunk", "--scattered")
    words = ("seed=3", "folds = 3", "trunk=false", "scattered=true")
    new = fit(pictures, tmp_path / "new", *(f"--set={word}" for word in words))

    assert len(options) - len(under_set) <= 12
    assert [name for name in under_set if f"| `{name}` |" not in page] == []
    assert (old.exit_code, new.exit_code) == (0, 0), new.output
    one, two = (Bundle.load(tmp_path / name).manifest for name in ("old", "new"))
    assert one.model_copy(update={"cost": None}) == two.model_copy(update={"cost": None})
    assert fit(pictures, tmp_path / "b", "--set", "trunk=no").exit_code == 2
    assert fit(pictures, tmp_path / "b", "--set", "folds=1").exit_code == 2
    assert fit(pictures, tmp_path / "b", "--set", "seed=-1").exit_code == 2
    assert not set(under_set) & {
        field
        for name in registry.names("detectors")
        for field in vars(registry.detector(name).parameters("paper"))
        if field != "mode"
    }


def test_a_fit_that_is_refused_says_what_is_wrong_with_its_presses(pictures: Path, tmp_path: Path) -> None:
    """Often it is the reason."""
    result = fit(pictures, tmp_path / "bolt", "--set", "register=always")

    assert isinstance(result.exception, FitError)
    assert "warning: the free gel is estimated from 6 presses" in result.output
