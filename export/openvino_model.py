"""A bundle as an OpenVINO model, made by OpenVINO's own converter from the merged graph.

Its scores on the golden frames must be those of the bundle; otherwise nothing is written.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from edge.core.errors import ConfigError
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from export.merge import merged_graph, smooth_first
from export.parity import ParityReport, compare, score_frames, score_stages

__all__ = ["write_openvino"]


def write_openvino(bundle: Bundle, output: Path) -> ParityReport:
    """Write `output` (.xml) and the weights next to it (.bin, float32); both or neither.

    Returns the comparison of map and score on the golden frames. Errors: ConfigError for another name or a graph that
    OpenVINO refuses, BundleCorrupt where the scores differ, OSError of the disk.
    """
    import openvino

    if output.suffix != ".xml":
        raise ConfigError(f"an OpenVINO model is a file .xml with a file .bin next to it; found {output}")
    graph = bundle.graphs.detector or merged_graph(bundle)
    if bundle.graphs.detector and bundle.manifest.is_smoothed:
        graph = smooth_first(graph, bundle.manifest.frame)
    try:
        with tempfile.TemporaryDirectory() as folder:  # the converter reads a file
            file = Path(folder) / "detector.onnx"
            file.write_bytes(graph)
            model = openvino.convert_model(file)
        model.set_rt_info(output.stem, "gelgate_model")
    except (RuntimeError, ValueError) as error:
        words = str(error).strip().splitlines() or [type(error).__name__]
        raise ConfigError(
            f"OpenVINO {openvino.__version__} refuses bundle {bundle.where}: {words[0]:.300}"
        ) from error
    report = _compare(openvino, model, bundle)
    report.raise_if_different()
    _save(openvino, model, output)
    return report


def _compare(openvino: Any, model: Any, bundle: Bundle) -> ParityReport:
    frames = np.stack(
        [golden.rgb for golden in bundle.golden] or [np.full((*bundle.manifest.frame, 3), 128, np.uint8)]
    )
    expected = score_frames(Scorer(bundle, is_skipping=False), frames)
    compiled = openvino.Core().compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    answers = [compiled(frame[None]) for frame in frames]
    maps, scores = (np.concatenate([answer[name] for answer in answers]) for name in ("score_map", "score"))
    title = f"{bundle.where} and its OpenVINO model"
    return compare(score_stages(expected, (maps, scores)), frames=frames, title=title)


def _save(openvino: Any, model: Any, output: Path) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output.parent, prefix=".openvino-") as folder:
        openvino.save_model(model, Path(folder) / output.name, compress_to_fp16=False)
        # The weights first: an .xml that is there has its weights.
        for suffix in (".bin", ".xml"):
            (Path(folder) / output.with_suffix(suffix).name).replace(output.with_suffix(suffix))
