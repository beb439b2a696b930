"""The bundles of a run: of two parts, with the smallest detector."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
from station import HEADER, Motion, jpeg
from tiny import TinyDetector, TinyParameters, tiny_trunk

from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.trunks import Trunk
from edge.core.detector import Bank, Grid
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.recording.format import RecordingWriter
from simulation.hand import SIZE, draw_gel

PARTS = ("PZ0", "PZ1")
PROFILE = SensorProfile("simulated", SIZE, (0.0, 0.0), SIZE, 1, 8.0)
REGION = Region(48, 28, 64, 64)


class Overflowing(TinyDetector):
    """The smallest detector; its score is not a number where a place is much brighter than any press."""

    def head(self, grid: Grid, bank: Bank, parameters: TinyParameters) -> bytes:
        c, h, w = grid.taps["layer1"]
        model = onnx.parser.parse_model(f"""
            < ir_version: 8, opset_import: ["" : 17] >
            head (float[n, {c}, {h}, {w}] layer1, float[{c}, {h}, {w}] mean)
                => (float[n, H, W] score_map, float[n] score)
            <float[4] scales = {{1.0, 1.0, 8.0, 8.0}}, int64[1] one = {{1}}, float steep = {{250.0}}, float zero = {{0.0}}>
            {{
                difference = Sub (layer1, mean)
                cell = ReduceL2 <axes = [1], keepdims = 1> (difference)
                wide = Resize <mode = "nearest", coordinate_transformation_mode = "asymmetric", nearest_mode = "floor">
                    (cell, , scales)
                score_map = Squeeze (wide, one)
                largest = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
                brighter = ReduceMax <axes = [1, 2, 3], keepdims = 0> (difference)
                far = Mul (brighter, steep)
                overflowing = Exp (far)
                nothing = Mul (overflowing, zero)
                score = Add (largest, nothing)
            }}
        """)  # noqa: E501
        return bytes(model.SerializeToString())


def both_bundles(folder: Path) -> list[Path]:
    """Fit them on the same presses; beside them `shadow`, of the first part, which passes everything."""
    detector, trunk = Overflowing(), Trunk("tiny", tiny_trunk())
    nominal = read_presses([_record(folder / "nominal", 12)], PROFILE, REGION)
    configs = (FitConfig(part, "pos1", PROFILE, REGION, detector, trunk, threshold=0.1) for part in PARTS)
    shadow = FitConfig(PARTS[0], "pos1", PROFILE, REGION, detector, trunk, threshold=1000.0)
    fit_files(nominal, shadow, created="2026-01-01").write(folder / "shadow")
    return [
        fit_files(nominal, config, created="2026-01-01").write(folder / config.part) for config in configs
    ]


def _record(folder: Path, presses: int) -> Path:
    """Record presses of sound parts."""
    rng, motion = np.random.default_rng(1), Motion()
    phases: list[tuple[float, int | None]] = [(0.0, None)] * motion.free
    for press in range(presses):
        phases += [(0.5, press)] + [(1.0, press)] * motion.hold + [(0.3, press)] + [(0.0, None)] * motion.idle
    with RecordingWriter(folder, replace(HEADER, mode=SIZE, profile="")) as writer:
        for number, (depth, press) in enumerate(phases):
            picture = jpeg(draw_gel(rng, depth, "sound"))
            writer.add(picture, round(number * 1e9 / HEADER.nominal_fps), {"press": press})
    return folder
