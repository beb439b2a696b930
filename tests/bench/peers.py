"""anomalib's PaDiM and PatchCore as rows of the same run: same presses, same measures, timed in the same rounds.

In an environment of its own, for anomalib brings another OpenCV:

    python3 -m venv peers
    peers/bin/pip install '.[studies,train]' 'anomalib>=2.7'
    peers/bin/pip uninstall --yes opencv-python opencv-python-headless
    peers/bin/pip install --force-reinstall --no-deps opencv-contrib-python-headless
    gelgate lab simulate paper
    peers/bin/python tests/bench/peers.py paper out --part PZ3 --position pos1
    cp out/rows.jsonl docs/studies/tradeoff.jsonl

They run as anomalib defines them, in PyTorch, on a ResNet-18 with the weights of the shipped trunk, so that methods and
programs are compared and not weights. Their published figures are for other weights and pictures (MVTec AD), which are
not at hand here.

Ref: anomalib 2.7 (Apache-2.0), models/image/padim and models/image/patchcore, with their default settings.
"""

import argparse
import ctypes
import hashlib
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.rows import ROW_FORMAT
from calibration.experiments.tradeoff.accuracy import measure_accuracy
from calibration.experiments.tradeoff.front import Row
from calibration.experiments.tradeoff.plan import Run, TradeoffArguments
from calibration.experiments.tradeoff.point import VIEWS
from calibration.experiments.tradeoff.run import Frames, read_or_measure
from calibration.experiments.tradeoff.timing import Lane
from calibration.fitting.trunks import open_trunk
from calibration.progress import progress
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.frames import CameraFrame

PRESSES: Final = 20
LAYERS: Final = {"padim": ["layer1", "layer2", "layer3"], "patchcore": ["layer2", "layer3"]}
CORESET: Final = 0.1
"""anomalib's default share of the patches that PatchCore keeps."""

# mallopt(3) of glibc.
_M_MMAP_THRESHOLD, _LARGE_BYTES = -3, 1 << 20

NAMES: Final = {"padim": "anomalib_padim", "patchcore": "anomalib_patchcore"}


def peers(run: Run, frames: Frames) -> list[tuple[Row, Lane]]:
    """Return the rows, not yet timed, and lanes of both models, fitted on the first presses and scored as every point.
    frames: camera frames to be timed on."""
    import torch

    torch.set_num_threads(run.given.threads)
    assert len(run.chosen.fitted) >= PRESSES, "press more good parts"
    normalise = _normaliser()
    return [_fit(method, run, normalise, frames[VIEWS["lr"].profile.size]) for method in LAYERS]


def _fit(
    method: str,
    run: Run,
    normalise: Callable[[NDArray[np.uint8]], Any],
    frames: Sequence[CameraFrame],
) -> tuple[Row, Lane]:
    import torch

    torch.manual_seed(run.given.seed)
    model = _model(method)
    start = time.perf_counter()
    nominal = [normalise(frame) for frame in run.chosen.read(run.chosen.fitted[:PRESSES], VIEWS["lr"])]
    learn(method, model, nominal)
    seconds = time.perf_counter() - start
    found = [_score(model, normalise(frame)) for frame in run.chosen.read(run.chosen.scored, VIEWS["lr"])]
    maps, scores = zip(*found, strict=True)
    accuracy = measure_accuracy(maps, np.array(scores), run.truth)
    row = _row(method, model, accuracy, seconds, nominal[0])
    key = row["key"]

    def score(rgb: NDArray[np.uint8]) -> tuple[float, float]:
        start = time.perf_counter()
        _score(model, normalise(rgb))
        return 0.0, (time.perf_counter() - start) * 1e3  # its trunk is part of the model

    return row, Lane(VIEWS["lr"], frames, score, (VIEWS["lr"].profile.size, key, key))


def learn(method: str, model: Any, planes: Sequence[Any]) -> None:
    """Fit a model as anomalib's trainer does: without gradients."""
    import torch

    map_large_blocks()
    model.train()
    model.feature_extractor.eval()
    with torch.no_grad():
        for one in planes:
            model(one)
        if method == "padim":
            model.fit()
        else:
            model.subsample_embedding(CORESET)
    model.eval()


def map_large_blocks() -> None:
    """Have glibc map large blocks one by one, so that a freed one is given back. PatchCore takes 12 MB for each of
    1,567 selections of 20 presses, and by default the heap grows with most of them: 18 GB at the peak, 1.6 GB with
    this (measured with torch 2.14). Another C library is left as it is."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def _model(method: str) -> Any:
    """A fresh model on a ResNet-18 with the weights of the one that ships."""
    sys.path.append(str(Path(__file__).parents[1] / "support"))
    import cpu_torchvision  # noqa: F401

    if method == "padim":
        from anomalib.models.image.padim.torch_model import PadimModel

        model = PadimModel("resnet18", LAYERS[method], pre_trained=False)
    else:
        from anomalib.models.image.patchcore.torch_model import PatchcoreModel

        model = PatchcoreModel(LAYERS[method], "resnet18", pre_trained=False)
    load_weights(model.feature_extractor.feature_extractor, open_trunk("tactile_resnet18").graph)
    return model


def load_weights(network: Any, trunk: bytes) -> None:
    """Give a ResNet-18 of timm the weights of an ONNX trunk of the same family, batch norms folded into them."""
    import torch

    convolutions = {
        name: module for name, module in network.named_modules() if isinstance(module, torch.nn.Conv2d)
    }
    given = _weights(trunk)
    # Both list a block's 3x3 layers in the order of use; its 1x1 shortcut may come before or after them.
    for is_shortcut in (False, True):
        names = [name for name in convolutions if ("downsample" in name) is is_shortcut]
        kernels = [pair for pair in given if (pair[0].shape[2] == 1) is is_shortcut]
        for name, (kernel, bias) in zip(names, kernels, strict=False):
            _set(network, name, convolutions[name], torch.from_numpy(kernel), torch.from_numpy(bias))


def _set(network: Any, name: str, convolution: Any, kernel: Any, bias: Any) -> None:
    import torch

    if convolution.weight.shape != kernel.shape:
        raise ValueError(
            f"the layer {name} has weights {tuple(convolution.weight.shape)}, not {tuple(kernel.shape)}"
        )
    above, _, last = name.rpartition(".")
    normed = last.replace("conv", "bn") if last.startswith("conv") else "1"
    norm = network.get_submodule(f"{above}.{normed}" if above else normed)
    with torch.no_grad():
        convolution.weight.copy_(kernel)
        norm.weight.fill_(1.0)
        norm.bias.copy_(bias)
        norm.running_mean.fill_(0.0)
        norm.running_var.fill_(1.0 - norm.eps)


def _weights(trunk: bytes) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Kernel and bias of every convolution, in the order of use."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load_from_string(trunk).graph
    arrays = {one.name: numpy_helper.to_array(one).astype(np.float32) for one in graph.initializer}
    casts = {node.output[0]: node.input[0] for node in graph.node if node.op_type == "Cast"}
    return [
        (arrays[casts.get(node.input[1], node.input[1])], arrays[casts.get(node.input[2], node.input[2])])
        for node in graph.node
        if node.op_type == "Conv"
    ]


def _normaliser() -> Callable[[NDArray[np.uint8]], Any]:
    """Return what makes uint8 (h, w, 3) a normalised float32 tensor (1, 3, h, w), as the trunk's graph does."""
    import torch

    from plugins.backbones.input_steps import IMAGENET

    mean, std = (torch.tensor(values).view(1, 3, 1, 1) for values in (IMAGENET.mean, IMAGENET.std))

    def normalise(rgb: NDArray[np.uint8]) -> Any:
        planes = torch.from_numpy(np.ascontiguousarray(rgb)).permute(2, 0, 1)[None]
        return (planes.float() / 255 - mean) / std

    return normalise


def _score(model: Any, planes: Any) -> tuple[NDArray[np.float32], float]:
    """Score map (h, w) and score of one press."""
    import torch

    with torch.inference_mode():
        found = model(planes)
    return found.anomaly_map[0, 0].numpy().astype(np.float32), float(found.pred_score.flatten()[0])


def _row(method: str, model: Any, accuracy: dict[str, Any], seconds: float, planes: Any) -> Row:
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    held = [one for name, one in model.state_dict().items() if not name.startswith("feature_extractor")]
    bank = sum(one.numel() * one.element_size() for one in held)
    trunk = sum(one.numel() * one.element_size() for one in model.feature_extractor.parameters())
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model(planes)
    content = hashlib.sha256()
    for name, one in sorted(model.state_dict().items()):
        content.update(name.encode() + one.cpu().numpy().tobytes())
    return {
        "format": ROW_FORMAT,
        "key": f"{NAMES[method]}.resnet18.lr.{PRESSES}",
        "peer": f"anomalib {version('anomalib')}, torch {version('torch')}",
        "method": NAMES[method],
        "mode": "corrected",
        "backbone": "resnet18",
        "view": "lr",
        "settings": {},
        "presses": PRESSES,
        "gel_share": PRESSES / DEFAULT_LIMIT_PRESSES,
        "accuracy": accuracy,
        "bank_bytes": bank,
        "bank_bytes_unpacked": bank,
        "trunk_bytes": trunk,
        "trunk_sha256": content.hexdigest(),
        "content_sha256": content.hexdigest(),
        "fit_s": {"features": 0.0, "bank": seconds},
        "work": {"float32": float(counter.get_total_flops()), "int8": 0.0, "bytes": float(bank + trunk)},
        "peak_memory_bytes": None,
    }


if __name__ == "__main__":
    words = argparse.ArgumentParser(
        description="Measure a trade-off with anomalib's models among its points."
    )
    for name in ("dataset", "output"):
        words.add_argument(name, type=Path)
    for name in ("--part", "--position"):
        words.add_argument(name)
    given = words.parse_args()
    read_or_measure(Run.of(TradeoffArguments(**vars(given), overwrite=True)), progress, print, peers)
