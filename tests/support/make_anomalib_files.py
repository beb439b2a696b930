"""Trains models with anomalib and writes its files, and what anomalib itself computes from the same pictures.

It runs under an interpreter that has anomalib (`make test-importers` makes one) and imports nothing of gelgate:

    python make_anomalib_files.py PICTURES WEIGHTS.npz OUT '{"padim": {"backbone": "resnet18"}}' 224x224

PICTURES has the folders `good` and `bad`. Per model: `OUT/<name>.ckpt`, `.pt`, `<name>_onnx/model.onnx` with its
`model.onnx.data`, OpenVINO's `.xml` and `.bin`, and `<name>.npz` with the raw maps (n, h, w) and scores (n,) of every
picture of `good`, then `bad`, before normalisation, and whether the model was fitted to it. EfficientAD, STFPM,
SuperSimpleNet and Dinomaly are trained from random weights, for one epoch or `epochs`; WEIGHTS is of the others'
backbone.
"""

import json
import shutil
import sys
import time
from pathlib import Path

import cpu_torchvision  # noqa: F401
import numpy as np
import timm
import torch
from anomalib.data import Folder
from anomalib.deploy import ExportType
from anomalib.engine import Engine
from anomalib.models import Dfkde, Dfm, Dinomaly, EfficientAd, Padim, Patchcore, Stfpm, Supersimplenet
from PIL import Image

_mean = torch.mean


def mean(values, *args, device=None, **options):
    """anomalib 2.7.0 gives torch.mean a device, which it refuses, so its DFM of `nll` cannot be fitted as it is."""
    return _mean(values, *args, **options)


torch.mean = mean
MODELS = {"padim": Padim, "patchcore": Patchcore, "dfm": Dfm, "dfkde": Dfkde}
# They have no argument against the download of weights: here nothing is downloaded.
NETWORKS = {
    "efficient_ad": EfficientAd, "stfpm": Stfpm, "supersimplenet": Supersimplenet, "dinomaly": Dinomaly
}  # fmt: skip
EfficientAd.prepare_pretrained_model = lambda self: None
_create_model = timm.create_model
timm.create_model = lambda *args, **options: _create_model(*args, **{**options, "pretrained": False})


def files(folder: Path) -> list[tuple[str, Path]]:
    """The pictures, `good` before `bad`, with these names."""
    return [(part, file) for part in ("good", "bad") for file in sorted((folder / part).glob("*.png"))]


def pictures(folder: Path) -> torch.Tensor:
    """Float32 (n, 3, h, w) in 0..1, `good` before `bad`, as anomalib reads them."""
    planes = [np.asarray(Image.open(file).convert("RGB")).transpose(2, 0, 1) for _, file in files(folder)]
    return torch.from_numpy(np.stack(planes)).float() / 255


def trained(folder: Path, weights: Path, out: Path, kind: str, options: dict, size: tuple[int, int]):
    """A fitted model, with these backbone weights where it is no network, the names of the pictures that it was fitted
    to, and the seconds that this took."""
    torch.manual_seed(0)
    epochs = options.pop("epochs", 1)
    model = (
        network(folder, kind, options, size) if kind in NETWORKS else detector(weights, kind, options, size)
    )
    has_bad = any((folder / "bad").glob("*.png"))
    data = Folder(
        name="presses",
        root=folder,
        normal_dir="good",
        abnormal_dir="bad",
        train_batch_size=1 if kind == "efficient_ad" else 8,
        eval_batch_size=8,
        num_workers=0,
        val_split_mode="same_as_test",
        test_split_mode="from_dir" if has_bad else "synthetic",
        normal_split_ratio=0.2,
        seed=0,
    )
    engine = Engine(
        max_epochs=epochs,
        devices=1,
        accelerator="cpu",
        default_root_dir=out / "run",
        logger=False,
        enable_progress_bar=False,
    )
    start = time.perf_counter()
    engine.fit(model=model, datamodule=data)
    seconds = time.perf_counter() - start
    return engine, model, {Path(name).name for name in data.train_data.samples.image_path}, seconds


def detector(weights: Path, kind: str, options: dict, size: tuple[int, int]):
    """A model that is not fitted yet, with these backbone weights."""
    crop = options.pop("center_crop_size", None)
    pre = {} if crop is None else {"center_crop_size": tuple(crop)}
    cls = MODELS[kind]
    model = cls(
        pre_trained=False, pre_processor=cls.configure_pre_processor(size, **pre), visualizer=False, **options
    )
    state = {name: torch.from_numpy(value) for name, value in np.load(weights).items()}
    missing, _ = model.model.feature_extractor.feature_extractor.load_state_dict(state, strict=False)
    if [name for name in missing if "num_batches_tracked" not in name]:
        raise SystemExit(f"the weights lack {missing[:4]}")
    return model


def network(folder: Path, kind: str, options: dict, size: tuple[int, int]):
    """An untrained network. EfficientAD's other pictures, ImageNet's in its paper, are the presses themselves."""
    crop = options.pop("crop_size", None)
    pre = {} if crop is None else {"crop_size": crop}
    cls = NETWORKS[kind]
    more = {"imagenet_dir": folder} if kind == "efficient_ad" else {}
    return cls(pre_processor=cls.configure_pre_processor(size, **pre), visualizer=False, **more, **options)


def computed(model, planes: torch.Tensor):
    """Scores (n,), maps (n, h, w) or None, and processor seconds (n, 2), picture by picture: of all, of the backbone.
    One thread: its processor time hardly depends on what else the machine does."""
    maps, scores, times = [], [], []
    torch.set_num_threads(1)
    with torch.no_grad():
        for one in planes:
            start = time.process_time()
            found = model(one[None].clone())
            middle = time.process_time()
            if hasattr(model, "feature_extractor"):
                model.feature_extractor(one[None].clone())
            times.append((middle - start, time.process_time() - middle))
            scores.append(found.pred_score.reshape(-1).numpy())
            maps.append(None if found.anomaly_map is None else found.anomaly_map[:, 0].numpy())
    return np.concatenate(scores), None if maps[0] is None else np.concatenate(maps), np.array(times)


def main(folder: Path, weights: Path, out: Path, wanted: dict, size: tuple[int, int]) -> None:
    """Train, export, and store what anomalib computes."""
    out.mkdir(parents=True, exist_ok=True)
    frames = pictures(folder)
    for name, options in wanted.items():
        kind = options.pop("kind", name)
        formats = options.pop("formats", ["torch", "onnx", "openvino"])
        engine, model, names, seconds = trained(folder, weights, out, kind, options, size)
        engine.trainer.save_checkpoint(out / f"{name}.ckpt")
        model.eval()
        scores, maps, times = computed(model.model, model.pre_processor.transform(frames))
        # An exported module resizes without antialiasing.
        exported, exported_maps, _ = computed(model.model, model.pre_processor.export_transform(frames))
        post = model.post_processor
        np.savez(
            out / f"{name}.npz",
            score=scores,
            exported_score=exported,
            processor_seconds=times,
            fit_seconds=seconds,
            trained=[part == "good" and file.name in names for part, file in files(folder)],
            image_threshold=float(post.image_threshold),
            image_min=float(post.image_min),
            image_max=float(post.image_max),
            **({} if maps is None else {"score_map": maps, "exported_score_map": exported_maps}),
        )
        for form in formats:
            model_path = engine.export(
                model=model, export_type=ExportType(form), export_root=out / "export" / name
            )
            if form == "onnx":
                # The graph names the file of its weights, so both keep their names.
                shutil.copytree(Path(model_path).parent, out / f"{name}_onnx", dirs_exist_ok=True)
            for file in Path(model_path).parent.iterdir():
                if file.suffix in (".pt", ".xml", ".bin"):
                    shutil.copy(file, out / f"{name}{file.suffix}")


if __name__ == "__main__":
    height, width = (int(number) for number in sys.argv[5].split("x"))
    main(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), json.loads(sys.argv[4]), (height, width))
