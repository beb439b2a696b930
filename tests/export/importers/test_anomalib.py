"""Files that anomalib wrote become models that compute what anomalib computes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from anomalib_files import (
    SMALL,
    WANTED,
    interpreter,
    made_by_anomalib,
    pictures,
    write_pictures,
    write_weights,
)
from imported import scores_of
from numpy.typing import NDArray
from toy_trunk import features_of

from edge.core.errors import ConfigError
from export.graph_file import read_graph
from export.importers.anomalib import anomalib
from export.importers.contract import Imported, Settings
from export.importers.heads import Framing
from export.onnx_values import run_values
from export.parity import Stage, compare, order_stage
from export.single_graph import adapt
from plugins.backbones.input_steps import InputSteps, apply_steps, input_planes, linear_matrix
from plugins.onnx_builder import Graph
from plugins.reading.files import read_here
from plugins.reading.foreign import Foreign

PIXELS_PER_MM = 15.77
# Scores of float32 graphs in another order of sums, relative to the largest: measured 2e-6 to 2e-5.
ALIKE = 1e-4


def opened(path: Path) -> Foreign:
    """A file read in this process: the files here are known."""
    return Foreign(path, *read_here(path))


def imported(path: Path, frames: NDArray[np.uint8], **settings: Any) -> Imported:
    given = Settings(frames.shape[1:3], PIXELS_PER_MM, **{"packing": "none", **settings})
    return anomalib.imported(opened(path), given)


def check(path: Path, frames: NDArray[np.uint8], expected: Any, prefix: str = "") -> None:
    """Score, map and order are anomalib's, stage by stage."""
    model = imported(path, frames)
    found = scores_of(model, frames)
    score = expected[f"{prefix}score"].astype(np.float64)
    if model.method == "dfkde":
        score = np.log(score / (1 - score))
    stages = [Stage("score", score, found.score, "score", ALIKE), order_stage(score, found.score)]
    if f"{prefix}score_map" in expected:
        # anomalib's map is in the model's input; its maximum is drawn in the frame a little lower.
        peaks = expected[f"{prefix}score_map"].max(axis=(1, 2))
        stages.insert(0, Stage("map", peaks, found.score_map.max(axis=(1, 2)), "map", 0.05))
    compare(stages).raise_if_different()


@pytest.mark.parametrize("file", ["padim.ckpt", "patchcore.pt", "dfm.ckpt", "dfkde.ckpt"])
def test_a_file_of_anomalib_scores_as_anomalib(file: str) -> None:
    """Checkpoint and exported module of anomalib 2.7.0, with its resize, colours and blur."""
    kind = file.partition(".")[0]
    prefix = "exported_" if file.endswith(".pt") else ""

    check(SMALL / file, pictures(), np.load(SMALL / f"{kind}.npz"), prefix)


@pytest.mark.parametrize("file", ["padim.ckpt", "patchcore.pt"])
def test_a_map_is_anomalibs_pixel_by_pixel(file: str) -> None:
    """The map, drawn from the model's input in the frame: every pixel, the border included."""
    expected = np.load(SMALL / f"{file.partition('.')[0]}.npz")
    maps = expected["exported_score_map" if file.endswith(".pt") else "score_map"].astype(np.float64)
    model = imported(SMALL / file, pictures())
    raw_size = Framing((48, 64), (32, 32))
    drawn = raw_size.back(0) @ maps @ raw_size.back(1).T

    found = scores_of(model, pictures())

    compare([Stage("map", drawn, found.score_map, "map", ALIKE)]).raise_if_different()


def test_what_a_file_is() -> None:
    """Method, backbone, layers and where it comes from."""
    found = anomalib.recognised(opened(SMALL / "padim.ckpt"))

    assert found is not None
    assert found.what == "PaDiM of anomalib (PyTorch archive)"
    assert found.fields["backbone"] == "resnet18"
    assert found.fields["layers"] == "layer1"


@pytest.mark.parametrize("sensitivity", [0.5, 0.7])
def test_the_threshold_is_on_the_raw_scale(sensitivity: float) -> None:
    """anomalib says anomalous where (score - t) / (max - min) + 1/2 exceeds 1 - sensitivity; it is said in words."""
    file = opened(SMALL / "padim.ckpt")
    file.content["anomalib_post_processor_config"]["image_sensitivity"] = sensitivity
    expected = np.load(SMALL / "padim.npz")

    model = anomalib.imported(file, Settings((48, 64), PIXELS_PER_MM))

    shift = (sensitivity - 0.5) * float(expected["image_max"] - expected["image_min"])
    assert model.threshold == pytest.approx(float(expected["image_threshold"]) - shift)
    assert "normalised scores from" in model.says[0]


@pytest.mark.parametrize("rank", [None, 2])
def test_the_reduction_is_exact_or_states_its_loss(rank: int | None) -> None:
    """The thin form keeps every direction that presses gave, and its distances are those of the dense matrices; with
    two directions the sentence says how many would be exact, and distances do change."""
    model = imported(SMALL / "padim.ckpt", pictures(), **({} if rank is None else {"rank": rank}))
    assert model.exact is not None
    full, thin = model.exact(features_of(model.trunk.graph, pictures()))

    assert ("would be exact" in " ".join(model.says)) == (rank is not None)
    loss = np.abs(full - thin).max() / full.max()
    basis = model.bank.arrays["basis"].shape[1]
    assert (basis < 12 and loss <= 1e-4) if rank is None else (basis == 2 and loss > 1e-3)


def steps(content: dict[Any, Any]) -> list[Any]:
    found: list[Any] = content["anomalib_pre_processor_config"]["transform"]["init_args"]["transforms"]
    return found


def step(kind: str, **fields: object) -> dict[str, object]:
    return {"class_path": f"torchvision.transforms.v2.{kind}", "init_args": fields}


INVERSE = "model.gaussian.inv_covariance"

Change = Callable[[dict[Any, Any]], object]
CHANGES: dict[str, tuple[Change, str]] = {
    "no mean": (lambda c: c["state_dict"].pop("model.gaussian.mean"), r"gaussian\.mean' is missing, numbers of shape"),
    "an unfitted model": (
        lambda c: c["state_dict"].update({INVERSE: np.empty((0, 12, 12), np.float32)}),
        r"'model\.gaussian\.inv_covariance' is empty",
    ),
    "another picture size": (
        lambda c: steps(c)[0]["init_args"].update(size=[64, 64]),
        r"'mean' has 64 places, the taps give 256",
    ),
    "a rotation before the model": (
        lambda c: steps(c).append(step("RandomRotation")),
        r"steps are Resize, Normalize, RandomRotation; Resize, CenterCrop and Normalize were expected, each at most",
    ),
    "a crop before the resize": (
        lambda c: steps(c).insert(0, step("CenterCrop", size=[40, 40])), r"steps are CenterCrop, Resize, Normalize;",
    ),
    "a resize after a resize": (
        lambda c: steps(c).insert(0, step("Resize", size=[16, 16])), r"steps are Resize, Resize, Normalize;",
    ),
    "colours that are scaled twice": (
        lambda c: steps(c).append(step("Normalize", mean=[0.5] * 3, std=[0.5] * 3)),
        r"steps are Resize, Normalize, Normalize;",
    ),
    "no pre-processor": (lambda c: c.pop("anomalib_pre_processor_config"), r"the pre-processor is not stored"),
    "an unknown backbone": (
        lambda c: c["hyper_parameters"].update(backbone="mobilenetv3"), r"'backbone' is mobilenetv3, one of",
    ),
    "missing layers": (
        lambda c: c["hyper_parameters"].update(layers=["layer1", "layer4"]), r"missing \(layer2\.0\.conv1\.weight",
    ),
    "values that are not finite": (
        lambda c: c["state_dict"].update({"model.gaussian.mean": np.full((12, 64), np.nan)}), r"not finite",
    ),
    "channels that do not exist": (
        lambda c: c["state_dict"].update({"model.idx": np.arange(60, 72)}), r"the selected channels go from 60 to 71",
    ),
    "matrices that are no covariances": (
        lambda c: c["state_dict"].update({INVERSE: -np.array(c["state_dict"][INVERSE])}),
        r"with the eigenvalue",
    ),
}  # fmt: skip


def nll(sigma: NDArray[np.float32], rows: int = 0, columns: int = 0) -> Change:
    """Make a DFM of `fre` one of `nll`, with these singular values; its vectors lack `rows` and `columns`."""

    def edit(content: dict[Any, Any]) -> None:
        count = content["state_dict"]["model.pca_model.singular_vectors"].shape[1]
        u = np.eye(count, len(sigma), dtype=np.float32)[: count - rows, columns:]
        arrays = {"u_mat": u, "sigma_mat": sigma, "mean_vec": np.zeros(count, np.float32)}
        content["state_dict"].update({f"model.gaussian_model.{key}": value for key, value in arrays.items()})
        content["hyper_parameters"]["score_type"] = "nll"

    return edit


OPTIONS: dict[str, tuple[str, Change, str]] = {
    "no pooling": (
        "dfm.ckpt", lambda c: c["hyper_parameters"].update(pooling_kernel_size=0),
        r"'pooling_kernel_size' is int 0, a number of 1 to 8 was expected",
    ),
    "pooling larger than the map": (
        "dfm.ckpt", lambda c: c["hyper_parameters"].update(pooling_kernel_size=9), "is int 9, a number of 1 to 8",
    ),
    "pooling that is a text": (
        "dfm.ckpt", lambda c: c["hyper_parameters"].update(pooling_kernel_size="four"), "is str 'four', a number",
    ),
    "an unknown score": (
        "dfm.ckpt", lambda c: c["hyper_parameters"].update(score_type="mse"), "'score_type' is mse, fre or nll was",
    ),
    "nll without its Gaussian": (
        "dfm.ckpt", lambda c: c["hyper_parameters"].update(score_type="nll"),
        r"gaussian_model\.sigma_mat' is (missing|empty)",
    ),
    "a Gaussian without width": (
        "dfm.ckpt", nll(np.array([1, 0], np.float32)), r"'model\.gaussian_model\.sigma_mat' goes down to 0, positive",
    ),
    "a Gaussian of another width": (
        "dfm.ckpt", nll(np.ones(2, np.float32), rows=1), r"gaussian_model\.u_mat' ",
    ),
    "a Gaussian of another depth": (
        "dfm.ckpt", nll(np.ones(2, np.float32), columns=1), r"gaussian_model\.u_mat' ",
    ),
    "no neighbours": (
        "patchcore.pt", lambda c: c["model"].state["_hparams"].state.append(["num_neighbors", 0]),
        "'num_neighbors' is int 0, a number of 1",
    ),
    **{name: ("padim.ckpt", edit, sentence) for name, (edit, sentence) in CHANGES.items()},
}  # fmt: skip


@pytest.mark.parametrize("change", OPTIONS)
def test_a_wrong_field_is_named(change: str) -> None:
    """The sentence has the file, the field, what was found and what was expected."""
    name, edit, sentence = OPTIONS[change]
    file = opened(SMALL / name)
    if "state_dict" in file.content:
        file.content["state_dict"] = dict(file.content["state_dict"])
    edit(file.content)

    with pytest.raises(ConfigError, match=sentence) as refused:
        anomalib.imported(file, Settings((48, 64), PIXELS_PER_MM))
    assert name in str(refused.value)


@pytest.mark.train
@pytest.mark.parametrize(("pixels", "onto"), [(240, 64), (48, 32), (31, 64), (64, 64)])
@pytest.mark.parametrize("is_antialiased", [True, False])
def test_a_resize_is_pytorchs(pixels: int, onto: int, is_antialiased: bool) -> None:
    """The matrix of one axis against torch's interpolation."""
    import torch

    line = np.random.default_rng(0).random(pixels).astype(np.float32)
    expected = torch.nn.functional.interpolate(
        torch.from_numpy(line)[None, None, None], (1, onto), mode="bilinear", antialias=is_antialiased
    )

    np.testing.assert_allclose(
        linear_matrix(pixels, onto, is_antialiased) @ line, expected[0, 0, 0], atol=1e-5
    )


def test_a_crop_is_the_middle_of_the_resized_frame() -> None:
    """The network's input, in NumPy and in the graph."""
    frames = np.random.default_rng(0).integers(0, 256, (1, 48, 64, 3), dtype=np.uint8)
    resized = InputSteps((0.4, 0.5, 0.6), (0.2, 0.2, 0.3), (32, 40))
    graph, cropped = Graph("input"), replace(resized, crop=(24, 24))
    graph.output("planes", input_planes(graph, cropped, (48, 64)), ("n", 3, 24, 24))

    (planes,) = run_values(graph.serialise(), ["planes"], {"frames": frames}, "the graph")

    expected = apply_steps(resized, frames)[:, :, 4:28, 8:32]
    np.testing.assert_allclose(apply_steps(cropped, frames), expected, rtol=1e-6)
    np.testing.assert_allclose(planes, expected, atol=1e-4)
    assert Framing((48, 64), (32, 40), (24, 24)).seen == pytest.approx(24 * 24 / (32 * 40))


def test_what_a_crop_leaves_out_is_not_anomalous() -> None:
    """The model saw nothing there, so the map has the lowest score, a distance of 0; the sentence says how much."""
    file = opened(SMALL / "padim.ckpt")
    steps(file.content)[0]["init_args"]["size"] = [40, 40]
    steps(file.content).insert(1, step("CenterCrop", size=[32, 32]))

    model = anomalib.imported(file, Settings((48, 64), PIXELS_PER_MM))

    seen = np.zeros((48, 64), bool)
    seen[5:43, 6:58] = True  # a tenth of each side is cropped
    maps = scores_of(model, pictures()).score_map
    assert (maps[:, ~seen] == 0).all()
    assert (maps[:, seen] > 0).all()
    assert "sees the middle 64% of the region, damage beyond is not found" in " ".join(model.says)


@pytest.mark.parametrize(
    ("pool", "says"), [(4, ""), (3, "pools 8x8 features by 3: the last 2 rows and 2 columns")]
)
def test_what_pooling_leaves_out_is_said(pool: int, says: str) -> None:
    """DFM pools whole windows, as anomalib does: the rest has no part in score and map."""
    file = opened(SMALL / "dfm.ckpt")
    file.content["hyper_parameters"]["pooling_kernel_size"] = pool

    model = anomalib.imported(file, Settings((48, 64), PIXELS_PER_MM))

    assert ("are not seen" in " ".join(model.says)) == bool(says)
    assert says in " ".join(model.says)


@pytest.mark.importers
def test_new_files_of_the_installed_anomalib(tmp_path: Path) -> None:
    """Trained now, by whatever version is installed, with several layers, another size and a crop."""
    python = interpreter()
    frames = pictures(12, 3)
    write_pictures(tmp_path / "pictures", frames, 3)
    write_weights(tmp_path / "weights.npz")
    wanted = {
        "padim": {"backbone": "resnet18", "n_features": 30, "formats": ["torch", "onnx"]},
        "patchcore": {"backbone": "resnet18", "center_crop_size": [32, 32], "formats": ["torch"]},
        "dfm": {**WANTED["dfm"], "layer": "layer2", "score_type": "nll"},
        "dfkde": {**WANTED["dfkde"], "layers": ["layer4"]},
    }
    wanted["dfm"]["pca_level"] = 0.9
    made = made_by_anomalib(tmp_path, wanted, (40, 48), python)

    for name in wanted:
        expected = np.load(made / f"{name}.npz")
        if "center_crop_size" not in wanted[name]:
            check(made / f"{name}.ckpt", frames, expected)
        if "torch" in wanted[name].get("formats", []):
            check(
                made / f"{name}.pt",
                frames,
                {k: v for k, v in expected.items() if "map" not in k},
                "exported_",
            )
    wrapped = adapt(read_graph(made / "padim_onnx" / "model.onnx"), frames)
    (score,) = run_values(wrapped.graph, ["score"], {"frames": frames}, "the adapted graph")
    expected = np.load(made / "padim.npz")["exported_score"].astype(np.float64)
    compare([Stage("score", expected, score, "score", ALIKE)]).raise_if_different()
    assert "limited to 0..1" in wrapped.found["normalisation"]
