"""Files in the form of public scripts become models that compute what the scripts compute."""

import pickle
import random
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from imported import scores_of
from numpy.typing import NDArray
from toy_trunk import features_of, toy_trunk

from calibration.fitting.trunks import Trunk
from edge.core.detector import Bank, Grid
from edge.core.errors import ConfigError
from export.importers.amazon_patchcore import amazon_patchcore
from export.importers.contract import Importer, Settings, importer_of
from export.importers.memory_scripts import fapm_pickle, inreach_points, spade_features
from export.importers.padim_scripts import draw_channels, padim_pickle
from export.parity import Stage, compare, order_stage
from plugins.detectors.baselines.patchcore import patchcore
from plugins.detectors.common.smoothing import upsampling_matrix
from plugins.detectors.inreach import inreach
from plugins.detectors.inreach.paper import PAPER_TAPS
from plugins.reading.files import HEADER, read_here
from plugins.reading.foreign import Foreign

FRAME = (32, 40)
LAYERS = {"layer1": (6, 4), "layer2": (8, 8), "layer3": (10, 8)}


def frames(count: int, seed: int = 0, frame: tuple[int, int] = FRAME) -> NDArray[np.uint8]:
    """Pictures that vary, the last two more than the others."""
    rng = np.random.default_rng(seed)
    base = rng.integers(0, 256, (*frame, 3)).astype(float)
    found = [base + rng.normal(0, 10, base.shape) for _ in range(count)]
    for one in found[-2:]:
        one[8:16, 8:16] += 60
    return np.clip(np.stack(found), 0, 255).astype(np.uint8)


def opened(path: Path) -> Foreign:
    return Foreign(path, *read_here(path))


def stored(folder: Path, content: Any, name: str = "model.pkl") -> Path:
    (folder / name).write_bytes(pickle.dumps(content))
    return folder / name


def settings(trunk: bytes, frame: tuple[int, int] = FRAME, **values: Any) -> Settings:
    return Settings(frame, 15.77, Trunk("toy", trunk), packing="none", values=values)


def agree(
    expected: tuple[NDArray[Any], NDArray[Any]],
    importer: Importer,
    path: Path,
    given: Settings,
    pictures: Any,
) -> None:
    """Map, score and order of the imported model are those of the script."""
    found = scores_of(importer.imported(opened(path), given), pictures)
    stages = [
        Stage("map", expected[0], found.score_map, "map"),
        Stage("score", expected[1], found.score, "score"),
        order_stage(expected[1], found.score),
    ]
    compare(stages).raise_if_different()


def embedded(features: dict[str, NDArray[np.float32]]) -> NDArray[np.float64]:
    """PaDiM's embedding (n, channels, h, w): coarser layers are repeated."""
    h, w = features["layer1"].shape[2:]
    parts = [
        np.repeat(np.repeat(one, h // one.shape[2], axis=2), w // one.shape[3], axis=3)
        for one in features.values()
    ]
    return np.concatenate(parts, axis=1).astype(np.float64)


def fitted_padim(trunk: bytes, channels: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """mean (d, places) and covariance (d, d, places) as the port fits them."""
    x = embedded(features_of(trunk, frames(9)))[:, channels]
    x = x.reshape(*x.shape[:2], -1)
    mean = x.mean(axis=0)
    cov = np.stack(
        [np.cov(x[:, :, k], rowvar=False) + 0.01 * np.eye(x.shape[1]) for k in range(x.shape[2])], axis=2
    )
    return mean, cov


def padim_by_script(
    trunk: bytes, channels: NDArray[np.int64], mean: NDArray[Any], cov: NDArray[Any], again: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Maps and scores of test pictures by the published formula, with dense inverses."""
    x = embedded(features_of(trunk, frames(5, 1)))[:, channels]
    n, d, h, w = x.shape
    delta = x.reshape(n, d, -1) - mean
    inverse = np.linalg.inv(cov.transpose(2, 0, 1) + again * np.eye(d))
    distance = np.sqrt(np.einsum("ndp,pde,nep->np", delta, inverse, delta)).reshape(n, h, w)
    return smoothed(distance)


def smoothed(distance: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bilinear to the frame, then a Gaussian of four pixels, by scipy; the score is the maximum."""
    rows, columns = (upsampling_matrix(n, m) for n, m in zip(distance.shape[1:], FRAME, strict=True))
    maps = np.stack([scipy.ndimage.gaussian_filter(rows @ one @ columns.T, sigma=4) for one in distance])
    return maps, maps.max(axis=(1, 2))


CHANNELS = np.array([20, 3, 0, 9, 15, 22])


@pytest.mark.parametrize("form", ["table", "list", "places first", "float32"])
def test_padim_by_its_formula(tmp_path: Path, form: str) -> None:
    """Mean, covariance and channels, in a table or a list, with the places first or last."""
    trunk = toy_trunk(LAYERS)
    mean, cov = fitted_padim(trunk, CHANNELS)
    content: Any = {"mean": mean, "cov": cov, "idx": CHANNELS}
    if form == "list":
        content = [mean, cov, CHANNELS]
    if form == "places first":
        first = np.ascontiguousarray(cov.transpose(2, 0, 1))
        content = {"mean": mean, "covariance": first, "selected_index": list(CHANNELS)}
    if form == "float32":
        content = {
            name: value.astype(np.float32) if name != "idx" else value for name, value in content.items()
        }
    path = stored(tmp_path, content)

    expected = padim_by_script(trunk, CHANNELS, mean, cov)
    agree(expected, padim_pickle, path, settings(trunk), frames(5, 1))


def test_the_seed_papers_second_ridge(tmp_path: Path) -> None:
    """Its scripts add 0.01 again at prediction; the importer says so, and does it where it is asked."""
    trunk = toy_trunk(LAYERS)
    mean, cov = fitted_padim(trunk, CHANNELS)
    path = stored(tmp_path, {"mean": mean, "cov": cov, "idx": CHANNELS})

    expected = padim_by_script(trunk, CHANNELS, mean, cov, again=0.01)
    agree(expected, padim_pickle, path, settings(trunk, ridge_again=0.01), frames(5, 1))
    assert "--set ridge_again=0.01" in " ".join(padim_pickle.imported(opened(path), settings(trunk)).says)


def test_the_ports_channels_are_drawn_again(tmp_path: Path) -> None:
    """The port stores no channels: those of Python's seed 1024 are taken, and the sentence says so."""
    trunk = toy_trunk(LAYERS)
    channels = draw_channels(24, 7)
    mean, cov = fitted_padim(trunk, channels)
    path = stored(tmp_path, [mean.astype(np.float32), cov.astype(np.float32)])

    agree(padim_by_script(trunk, channels, mean, cov), padim_pickle, path, settings(trunk), frames(5, 1))
    assert "random.seed(1024)" in padim_pickle.imported(opened(path), settings(trunk)).says[0]
    random.seed(1024)
    assert draw_channels(1792, 550).tolist() == random.sample(range(1792), 550)


def spade_by_script(
    bank: dict[str, NDArray[Any]], asked: dict[str, NDArray[Any]], is_normalised: bool, k: int = 5
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Maps and scores by the published formula: nearest presses by avgpool, then cells among all of theirs."""

    def rows(one: NDArray[Any]) -> NDArray[np.float64]:
        flat = one.reshape(len(one), -1).T.astype(np.float64)
        return flat / (np.linalg.norm(flat, axis=1, keepdims=True) + 1e-6) if is_normalised else flat

    apart = scipy.spatial.distance.cdist(asked["avgpool"][:, :, 0, 0], bank["avgpool"][:, :, 0, 0])
    order = np.argsort(apart, axis=1)[:, :k]
    layers = [name for name in bank if name != "avgpool"]
    maps = np.zeros((len(apart), *FRAME))
    for layer in layers:
        gallery = [rows(one) for one in bank[layer]]
        distance = np.stack(
            [
                scipy.spatial.distance.cdist(rows(one), np.concatenate([gallery[j] for j in near]))
                .min(axis=1)
                .reshape(one.shape[1:])
                for one, near in zip(asked[layer], order, strict=True)
            ]
        )
        up = (upsampling_matrix(n, m) for n, m in zip(distance.shape[1:], FRAME, strict=True))
        down, across = up
        maps += down @ distance @ across.T / len(layers)
    return np.stack([scipy.ndimage.gaussian_filter(one, sigma=4) for one in maps]), np.sort(apart, axis=1)[
        :, :k
    ].mean(axis=1)


@pytest.mark.parametrize("is_normalised", [True, False])
@pytest.mark.parametrize("as_list", [True, False])
def test_spade_by_its_formula(tmp_path: Path, is_normalised: bool, as_list: bool) -> None:
    """Features by layer, as one array or as a list of presses."""
    trunk = toy_trunk({**LAYERS, "avgpool": (12, 1)})
    bank = features_of(trunk, frames(7))
    content = OrderedDict((name, list(value) if as_list else value) for name, value in bank.items())
    path = stored(tmp_path, content)

    expected = spade_by_script(bank, features_of(trunk, frames(5, 1)), is_normalised)
    agree(expected, spade_features, path, settings(trunk, is_normalised=is_normalised), frames(5, 1))


def test_spade_asks_for_what_the_file_does_not_say(tmp_path: Path) -> None:
    """Whether the scores divide by the length is not in the file."""
    trunk = toy_trunk(LAYERS)
    path = stored(tmp_path, features_of(trunk, frames(7)))

    with pytest.raises(ConfigError, match=r"state it: --set is_normalised=false for SPADE-pytorch, true for"):
        spade_features.imported(opened(path), settings(trunk))


BIG = (224, 224)
FAPM = {"layer2": (6, 8), "layer3": (5, 16)}


def fapm_bank(is_cell: bool, seed: int = 3) -> dict[str, NDArray[Any]]:
    """Prototypes as the release stores them, per cell, or per place as the seed paper's scripts do."""
    rng = np.random.default_rng(seed)
    content: dict[str, NDArray[Any]] = {}
    for end, channels, places in (("f", 6, 16), ("c", 5, 4)):
        for kind, count in (("near", 5), ("far", 9)):
            shape = (49, count, channels) if is_cell else (49, places, count, channels)
            content[f"final_{kind}_core_{end}"] = rng.random(shape).astype(np.float32)
        content[f"fn_selector_{end}"] = rng.random((49, 1)) < 0.2
    return content


def fapm_by_script(
    content: dict[str, NDArray[Any]], features: dict[str, NDArray[Any]]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Maps and scores by the release's formula, its order of coarse distances included."""

    def scores(one: NDArray[Any], end: str, side: int) -> NDArray[Any]:
        c = len(one)
        padded = np.pad(one, ((0, 0), (1, 1), (1, 1)))
        pooled = (
            sum(padded[:, i : i + one.shape[1], j : j + one.shape[2]] for i in range(3) for j in range(3)) / 9
        )
        cells = pooled.reshape(c, 7, side, 7, side).transpose(1, 3, 2, 4, 0).reshape(49, side * side, c)
        found = np.empty((49, side * side, 4))
        for k, is_far in enumerate(content[f"fn_selector_{end}"].ravel()):
            bank = content[f"final_{'far' if is_far else 'near'}_core_{end}"][k]
            for place in range(side * side):
                rows = bank if bank.ndim == 2 else bank[place]
                found[k, place] = np.sort(np.linalg.norm(rows - cells[k, place], axis=1))[:4]
        return found

    maps, images = [], []
    for fine, coarse in zip(features["layer2"], features["layer3"], strict=True):
        both = scores(fine.astype(np.float64), "f", 4) + np.repeat(
            scores(coarse.astype(np.float64), "c", 2), 4, axis=1
        )
        grid = both[:, :, 0].reshape(7, 7, 4, 4).transpose(0, 2, 1, 3).reshape(28, 28)
        up = upsampling_matrix(28, 224)
        maps.append(scipy.ndimage.gaussian_filter(up @ grid @ up.T, sigma=4))
        flat = both.reshape(-1, 4)
        near = flat[flat[:, 0].argmax()]
        images.append((1 - np.exp(near).max() / np.exp(near).sum()) * flat[:, 0].max())
    return np.array(maps), np.array(images)


@pytest.mark.parametrize("is_cell", [True, False])
def test_fapm_by_its_formula(tmp_path: Path, is_cell: bool) -> None:
    """Near and far prototypes with their selectors, per cell and per place."""
    trunk = toy_trunk(FAPM)
    content = fapm_bank(is_cell)
    path = stored(tmp_path, content)
    pictures = frames(3, 1, BIG)

    expected = fapm_by_script(content, features_of(trunk, pictures))
    agree(expected, fapm_pickle, path, settings(trunk, BIG), pictures)


def paper_trunk() -> bytes:
    """The thirteen taps of InReaCh's descriptor."""
    return toy_trunk({tap: (4, 2 ** min(int(tap[5]) + 1, 3)) for tap in PAPER_TAPS})


@pytest.mark.parametrize("width", [1024, 1026])
def test_inreach_by_its_formula(tmp_path: Path, width: int) -> None:
    """Nominal points, with places or without: squared distances, as the detector's oracle has them."""
    rng = np.random.default_rng(0)
    points = rng.random((60, width)).astype(np.float32)
    path = stored(tmp_path, {"nominal_points": points})
    trunk = paper_trunk()
    features = features_of(trunk, frames(3, 1))
    grid = Grid(FRAME, {tap: one.shape[1:] for tap, one in features.items()}, 15.77)
    parameters = inreach.parameters("paper", position_weight=5.0 if width > 1024 else 0.0)
    bank = Bank({"bank": points, "mean": np.zeros(1024, np.float32)})
    oracle = inreach.reference_score(features, grid, bank, parameters)

    agree((oracle.score_map, oracle.score), inreach_points, path, settings(trunk), frames(3, 1))


def amazon(folder: Path, rows: NDArray[np.float32], **changes: Any) -> Path:
    """The two files of `save_to_path`."""
    parameters = {
        "backbone.name": "wideresnet50", "layers_to_extract_from": ["layer2", "layer3"], "input_shape": (3, 32, 40),
        "pretrain_embed_dimension": 1024, "target_embed_dimension": 1024, "patchsize": 3, "patchstride": 1,
        "anomaly_scorer_num_nn": 1, **changes,
    }  # fmt: skip
    head = HEADER.pack(b"IxF2", rows.shape[1], len(rows), 1 << 20, 1 << 20, 1, 1)
    (folder / "nnscorer_search_index.faiss").write_bytes(head + struct.pack("<Q", rows.size) + rows.tobytes())
    return stored(folder, parameters, "patchcore_params.pkl")


def test_amazons_patchcore_by_its_formula(tmp_path: Path) -> None:
    """Rows of a flat index: squared distances of binned descriptors, as the detector's oracle has them."""
    rows = np.random.default_rng(0).random((40, 1024)).astype(np.float32)
    path = amazon(tmp_path, rows)
    trunk = toy_trunk({"layer2": (8, 4), "layer3": (10, 8)})
    features = features_of(trunk, frames(5, 1))
    grid = Grid(FRAME, {tap: one.shape[1:] for tap, one in features.items()}, 15.77)
    bank = Bank({"bank": rows, "mean": np.zeros(1024, np.float32)})
    oracle = patchcore.reference_score(features, grid, bank, patchcore.parameters("paper"))

    agree((oracle.score_map, oracle.score), amazon_patchcore, path, settings(trunk), frames(5, 1))


def test_every_file_is_recognised_by_one_importer(tmp_path: Path) -> None:
    """Each form has its importer, and no other one takes it."""
    trunk = toy_trunk(LAYERS)
    mean, cov = fitted_padim(trunk, CHANNELS)
    contents = {
        "padim_pickle": [mean, cov],
        "spade_features": features_of(trunk, frames(2)),
        "fapm_pickle": fapm_bank(True),
        "inreach_points": np.zeros((4, 1024), np.float32),
    }
    for name, content in contents.items():
        importer, _ = importer_of(opened(stored(tmp_path, content)))
        assert importer.name == name
    importer, what = importer_of(opened(amazon(tmp_path, np.zeros((2, 1024), np.float32))))
    assert importer.name == "amazon_patchcore"
    assert what.fields["index"] == "nnscorer_search_index.faiss"


def test_a_file_of_nobody_is_described(tmp_path: Path) -> None:
    """What it holds, which importers there are, and what else may be meant."""
    sentence = (
        r"a pickle that holds a table of weights; no importer knows it\. Known are .*padim_pickle.* wrap"
    )
    with pytest.raises(ConfigError, match=sentence):
        importer_of(opened(stored(tmp_path, {"weights": [1, 2]})))


FOUR_PLACES = np.stack([np.eye(3)] * 4, 2)
MEANS = np.zeros((3, 4))
SHORT_SELECTOR = {**fapm_bank(True), "fn_selector_f": np.zeros(7)}

WRONG: dict[str, tuple[Any, Importer, dict[str, Any], str]] = {
    "covariance of other channels": (
        [MEANS, np.zeros((2, 2, 4))], padim_pickle, {}, r"'covariance' is \(2, 2, 4\), \(3, 3, 4\) or",
    ),
    "places of another picture": ([MEANS, FOUR_PLACES], padim_pickle, {}, r"'mean' has 4 places, the taps give 80"),
    "a negative ridge": ([MEANS, FOUR_PLACES], padim_pickle, {"ridge_again": -1.0}, r"is no ridge"),
    "texts": ([MEANS, np.zeros((3, 3, 4)), ["a"]], padim_pickle, {}, r"'channels' is a list of 1"),
    "layers of another size": (
        {"layer1": np.zeros((2, 6, 3, 3))}, spade_features, {}, r"'layer1' is an array float64 \(2, 6, 3, 3\)",
    ),
    "no press": ({"layer1": []}, spade_features, {}, r"'layer1' is a list without arrays"),
    "another region": (SHORT_SELECTOR, fapm_pickle, {}, r"FAPM's cells need 28 x 28"),
    "a place without its weight": (
        np.zeros((3, 1026)), inreach_points, {"position_weight": 0.0}, r"do not fit together",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_script_file_is_named(tmp_path: Path, case: str) -> None:
    content, importer, values, sentence = WRONG[case]
    path = stored(tmp_path, content)

    with pytest.raises(ConfigError, match=sentence) as refused:
        importer.imported(opened(path), settings(toy_trunk({**LAYERS, "layer2": (8, 8)}), **values))
    assert "model.pkl" in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"patchsize": 5}, "'patchsize' is int 5, 3 was expected"),
        ({"anomaly_scorer_num_nn": 3}, "'anomaly_scorer_num_nn' is int 3, 1 was expected"),
        ({"layers_to_extract_from": []}, "'layers_to_extract_from' is a list of 0"),
    ],
)
def test_another_patchcore_is_refused(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    """Settings that these graphs would compute in another way."""
    path = amazon(tmp_path, np.zeros((2, 1024), np.float32), **changes)

    with pytest.raises(ConfigError, match=sentence):
        amazon_patchcore.imported(opened(path), settings(toy_trunk(LAYERS)))


def test_a_file_without_backbone_asks_for_it(tmp_path: Path) -> None:
    """The trunk of the training must be named."""
    path = stored(tmp_path, [np.zeros((3, 4)), np.stack([np.eye(3)] * 4, 2)])

    with pytest.raises(ConfigError, match=r"holds no weights of its backbone .* --backbone trunk\.onnx"):
        padim_pickle.imported(opened(path), Settings(FRAME, 15.77))
