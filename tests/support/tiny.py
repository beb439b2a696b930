"""The smallest complete detector: a trunk of pooled colours and the distance to the mean of the nominal presses.

For tests of everything around detectors (bundle, scorer, fit, gateway): it fits in a millisecond, its scores can be
worked by hand, and it meets the contract of `edge.core.detector`.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import onnx
import onnx.parser
from numpy.typing import NDArray

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Packing, Progress, ScoreMaps
from edge.core.errors import FitError
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import Graphs
from edge.model.bundle_writer import bundle_files
from edge.model.manifest import (
    Facts,
    GridEntry,
    Manifest,
    Provenance,
    ThresholdEntry,
    ToleranceEntry,
)
from edge.model.manifest_facts import GIVEN

PROFILE = SensorProfile("tiny", (48, 40), (0.0, 0.0), (48, 40), 1, 15.77)
REGION = Region(8, 4, 32, 32)


def tiny_trunk() -> bytes:
    """uint8 (n, h, w, 3) to `layer1` (n, 3, h/8, w/8) and `layer2` (n, 3, h/16, w/16): mean colours, 0 to 1."""
    model = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        tiny (uint8[n, h, w, 3] frames) => (float[n, 3, h8, w8] layer1, float[n, 3, h16, w16] layer2)
        <float white = {255.0}>
        {
            pixels = Cast <to = 1> (frames)
            unit = Div (pixels, white)
            planes = Transpose <perm = [0, 3, 1, 2]> (unit)
            layer1 = AveragePool <kernel_shape = [8, 8], strides = [8, 8]> (planes)
            layer2 = AveragePool <kernel_shape = [2, 2], strides = [2, 2]> (layer1)
        }
    """)
    return bytes(model.SerializeToString())


def tiny_grid(region: Region = REGION) -> Grid:
    h, w = region.height, region.width
    return Grid(
        (h, w), {"layer1": (3, h // 8, w // 8), "layer2": (3, h // 16, w // 16)}, PROFILE.pixels_per_mm
    )


class TinyBackbone:
    name = "tiny"

    def facts(self) -> dict[str, object]:
        return {"weights": "none: pooled colours"}

    def trunk(self, taps: tuple[str, ...] = ("layer1", "layer2")) -> bytes:
        return tiny_trunk()


@dataclass(frozen=True)
class TinyParameters:
    gain: float = 1.0
    packing: Packing = "none"


class TinyDetector:
    """score_map: gain times the distance of each layer1 cell to its nominal mean, spread over its 8x8 pixels."""

    name = "tiny"
    compares_places = False
    is_baseline = False

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> TinyParameters:
        try:
            return replace(TinyParameters(), **overrides)  # type: ignore[arg-type]
        except TypeError as error:
            raise FitError(f"tiny has no such parameter: {error}") from error

    def taps(self, parameters: TinyParameters) -> tuple[str, ...]:
        return ("layer1",)

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: TinyParameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        progress(1.0)
        mean = nominal.features["layer1"].mean(axis=0, dtype=np.float64).astype(np.float32)
        return Bank({"mean": mean}, {"mean": parameters.packing}, {"presses": nominal.presses})

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: TinyParameters
    ) -> ScoreMaps:
        difference = features["layer1"].astype(np.float64) - bank.arrays["mean"]
        cells = parameters.gain * np.sqrt((difference**2).sum(axis=1))
        score_map = cells.repeat(8, axis=1).repeat(8, axis=2)
        return ScoreMaps(score_map, score_map.max(axis=(1, 2)))

    def head(self, grid: Grid, bank: Bank, parameters: TinyParameters) -> bytes:
        c, h, w = grid.taps["layer1"]
        model = onnx.parser.parse_model(f"""
            < ir_version: 8, opset_import: ["" : 17] >
            head (float[n, {c}, {h}, {w}] layer1, float[{c}, {h}, {w}] mean)
                => (float[n, H, W] score_map, float[n] score)
            <float gain = {{{parameters.gain}}}, float[4] scales = {{1.0, 1.0, 8.0, 8.0}}, int64[1] one = {{1}}>
            {{
                difference = Sub (layer1, mean)
                cell = ReduceL2 <axes = [1], keepdims = 1> (difference)
                scaled = Mul (cell, gain)
                wide = Resize <mode = "nearest", coordinate_transformation_mode = "asymmetric", nearest_mode = "floor">
                    (scaled, , scales)
                score_map = Squeeze (wide, one)
                score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
            }}
        """)
        return bytes(model.SerializeToString())


TINY = TinyDetector()
TINY_BACKBONE = TinyBackbone()


def presses(n: int, seed: int = 0, region: Region = REGION) -> NDArray[np.uint8]:
    """n nominal frames of the region: uint8 (n, h, w, 3), grey with noise."""
    rng = np.random.default_rng(seed)
    return rng.integers(110, 140, (n, region.height, region.width, 3), dtype=np.uint8)


def tiny_facts(threshold: float = 0.05, **changes: Any) -> Facts:
    facts = Facts(
        part="bolt",
        position="crest",
        method="tiny",
        mode="corrected",
        parameters=asdict(TinyParameters()),
        profile=PROFILE,
        region=REGION,
        grid=GridEntry.of(tiny_grid()),
        threshold=ThresholdEntry(
            value=threshold, method=GIVEN, alpha=0.05, alpha_floor=1.0, nominal_scores=()
        ),
        tolerance=ToleranceEntry(score=1e-5, score_map=1e-5, relative=1e-4, measured=0.0),
        provenance=Provenance(created="2026-01-01"),
    )
    return facts.model_copy(update=changes)


def tiny_bank(value: float = 0.5, packing: Packing = "none") -> Bank:
    """A bank whose mean colour is the same everywhere."""
    return Bank({"mean": np.full(tiny_grid().taps["layer1"], value, np.float32)}, {"mean": packing})


def tiny_graphs() -> Graphs:
    return Graphs(trunk=tiny_trunk(), head=TINY.head(tiny_grid(), tiny_bank(), TinyParameters()))


def tiny_files(bank: Bank | None = None, **changes: Any) -> tuple[Manifest, dict[str, bytes]]:
    """The files of a bundle that scores the distance to mid grey (or to another bank's mean)."""
    bank = bank or tiny_bank()
    golden = changes.pop("golden", ())
    with_trunk = changes.pop("with_trunk", True)
    graphs = changes.pop("graphs", tiny_graphs())
    return bundle_files(tiny_facts(**changes), graphs, bank, golden, backbone="tiny", with_trunk=with_trunk)
