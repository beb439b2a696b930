"""A tiled trunk: the plain trunk's features of every tile in one mosaic, which detectors score as one map."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from graph_session import open_graph
from heads import fit, head_scores, largest_error
from typer.testing import CliRunner

from calibration.fitting.features import extract, trunk_grid
from edge.cli import build
from edge.core.detector import Nominal
from edge.core.errors import ConfigError, FitError
from edge.core.imaging.tiles import TILES_KEY, Tiles, tiling
from export.merge import mosaic_trunk
from plugins.backbones.random import random_state
from plugins.backbones.resnet import build_trunk
from plugins.backbones.tiled import tile_trunk
from plugins.detectors.padim import padim

TAPS = ("layer1", "layer2", "layer3", "avgpool")
TILES = tiling((96, 160), 64, 32)


@cache
def plain() -> bytes:
    return build_trunk(random_state("resnet18"), "resnet18", TAPS)


@cache
def tiled() -> bytes:
    return tile_trunk(plain(), TILES)


@cache
def session(graph: bytes) -> onnxruntime.InferenceSession:
    return open_graph(graph)


def frames(n: int) -> np.ndarray:
    rgb: np.ndarray = np.random.default_rng(0).integers(0, 256, (n, 96, 160, 3), dtype=np.uint8)
    return rgb


def test_a_mosaic_holds_every_tiles_own_features() -> None:
    """Each block of each tap is the plain trunk's output for that tile alone, for every frame of a batch."""
    rgb = frames(2)
    mosaics = dict(
        zip(TAPS, session(mosaic_trunk(plain(), TILES)).run(list(TAPS), {"frames": rgb}), strict=True)
    )
    for frame in range(2):
        alone = session(plain()).run(list(TAPS), {"frames": TILES.cut(rgb[frame])})
        for tap, features in zip(TAPS, alone, strict=True):
            c, h, w = features.shape[1:]
            expected = features.reshape(2, 4, c, h, w).transpose(2, 0, 3, 1, 4).reshape(c, 2 * h, 4 * w)
            np.testing.assert_allclose(mosaics[tap][frame], expected, rtol=1e-4, atol=1e-4)


def test_the_fit_finds_the_layout_in_the_trunk() -> None:
    """trunk_grid reads the tiles from the metadata; PaDiM fitted on them scores a frame as its oracle does."""
    trunk = session(tiled())
    grid = trunk_grid(trunk, TAPS[:3], (96, 160), 15.77)
    assert grid.tiles == TILES
    assert grid.taps["layer1"] == (64, 32, 64)
    features = extract(trunk, frames(7), grid, lambda fraction: None)
    train, query = ({tap: value[part] for tap, value in features.items()} for part in (slice(5), slice(5, 7)))
    bank = fit(padim, padim.parameters(), Nominal(train), grid)
    oracle = padim.reference_score(query, grid, bank, padim.parameters())
    assert oracle.score_map.shape == (2, 96, 160)
    assert largest_error(head_scores(padim, padim.parameters(), query, bank, grid), oracle) < 1e-4


def test_the_full_frame_needs_nothing_of_its_own() -> None:
    """The same frame without tiles: the plain trunk, a larger grid, the same detector."""
    trunk = session(plain())
    grid = trunk_grid(trunk, TAPS[:3], (96, 160), 15.77)
    assert grid.tiles is None
    assert grid.taps["layer1"] == (64, 24, 40)
    features = extract(trunk, frames(6), grid, lambda fraction: None)
    parameters = padim.parameters(taps=TAPS[:2], grid_tap="layer2", rank=4)
    bank = fit(padim, parameters, Nominal(features), grid)
    oracle = padim.reference_score(features, grid, bank, parameters)
    assert largest_error(head_scores(padim, parameters, features, bank, grid), oracle) < 1e-4


def test_neighbours_end_at_a_tile() -> None:
    """The 3x3 neighbourhood of a cell at a seam repeats it instead of reading from the next tile."""
    trunk = session(tiled())
    grid = trunk_grid(trunk, TAPS[:2], (96, 160), 15.77)
    train = extract(trunk, frames(2), grid, lambda fraction: None)
    parameters = padim.parameters(
        grid_tap="layer1", neighbours=1, is_balanced=False, projection="all", is_sampled=False
    )
    before = fit(padim, parameters, Nominal(train), grid)
    train["layer1"][:, :, :, :16] += 100
    after = fit(padim, parameters, Nominal(train), grid)
    moved = np.abs(after.arrays["mean"] - before.arrays["mean"])[:, :64].max(axis=1).reshape(32, 64)
    assert (moved[:, :16] > 99).all()
    assert (moved[:, 16:] == 0).all()


def test_only_a_plain_trunk_is_tiled_for_its_region() -> None:
    """A tiled trunk, tiles that the strides do not divide, and a region of another size are refused."""
    with pytest.raises(FitError, match=r"\(96, 160\).*\(64, 64\)"):
        trunk_grid(session(tiled()), TAPS[:3], (64, 64), 15.77)
    with pytest.raises(ConfigError, match="no tiles yet"):
        tile_trunk(tiled(), TILES)
    with pytest.raises(ConfigError, match="multiple of 32"):
        tile_trunk(plain(), tiling((96, 160), 48, 16))


def broken(change: str) -> bytes:
    """The plain trunk after one change."""
    import onnx

    if change in ("text", "empty"):
        return b"no graph" if change == "text" else b""
    model = onnx.load_from_string(plain())
    match change:
        case "flat":
            del model.graph.input[0].type.tensor_type.shape.dim[0]
        case "unsound":
            model.graph.node[0].input[0] = "nowhere"
        case "sized":
            weight = next(one for one in model.graph.initializer if len(one.dims) == 4)
            weight.CopyFrom(
                onnx.helper.make_tensor(weight.name, 1, [64, 7, 7, 7], b"\0" * 64 * 343 * 4, raw=True)
            )
    return bytes(model.SerializeToString())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("text", "no ONNX model"),
        ("empty", "only a plain trunk"),
        ("flat", "only a plain trunk"),
        ("unsound", "no sound ONNX model"),
        ("sized", "does not take tiles of 64 pixels"),
    ],
)
@pytest.mark.parametrize("tile", [tile_trunk, mosaic_trunk])
def test_what_is_no_trunk_is_refused(tile: Callable[[bytes, Tiles], bytes], change: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        tile(broken(change), TILES)


def test_the_layout_survives_writing() -> None:
    """What is written into the metadata is read back; anything else is refused."""
    assert Tiles.read(TILES.to_json()) == TILES
    for text in ("", "[]", "{}", '{"frame": 3}'):
        with pytest.raises(ValueError, match="not a layout"):
            Tiles.read(text)


def test_the_command_tiles_an_installed_backbone(tmp_path: Path) -> None:
    """`gelgate export tiles tactile_resnet18` writes a trunk with its layout inside, and refuses what it cannot
    tile."""
    output = tmp_path / "tiled.onnx"
    arguments = ["export", "tiles", "tactile_resnet18", "-o", str(output), "--size", "64", "--overlap", "32"]
    done = CliRunner().invoke(build(), [*arguments, "--frame", "160x96"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "8 tiles of 64 over 160x96" in done.output
    metadata = session(output.read_bytes()).get_modelmeta().custom_metadata_map
    assert Tiles.read(metadata[TILES_KEY]) == TILES
    before = output.read_bytes()
    (tmp_path / "link.onnx").hardlink_to(output)
    other = ["--frame", "160x96", "--overlap", "0", "--overwrite"]
    CliRunner().invoke(build(), [*arguments, *other], catch_exceptions=False)
    assert output.read_bytes() != before
    assert (tmp_path / "link.onnx").read_bytes() == before  # never half of it
    for wrong in (["--frame", "40x40"], ["--frame", "wide"], ["--overlap", "64", "--frame", "160x96"]):
        with pytest.raises(ConfigError, match="--frame"):
            CliRunner().invoke(build(), [*arguments, *wrong, "--overwrite"], catch_exceptions=False)
    with pytest.raises(ConfigError, match="neither a file nor"):
        CliRunner().invoke(
            build(), ["export", "tiles", "nothing", "-o", str(tmp_path / "x")], catch_exceptions=False
        )
