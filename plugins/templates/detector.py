"""By how many standard deviations each place of a press differs from the nominal presses there."""

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from edge.core.detector import Bank, Features, Grid, Mode, Nominal, Progress, ScoreMaps
from edge.core.errors import FitError


class Parameters(BaseModel, extra="forbid", frozen=True):
    """What `gelgate fit --set` may set."""

    least_deviation: float = Field(
        default=0.1, gt=0, description="the smallest standard deviation that is used"
    )


class Detector:
    """It learns arrays from nominal presses, and writes an ONNX graph that scores with them.

    The gateway runs the graph and never imports this file.
    """

    name = "template"
    compares_places = True
    is_baseline = False

    def parameters(self, mode: Mode = "corrected", **overrides: object) -> Parameters:
        """Return the parameters of a mode. Errors: FitError."""
        try:
            return Parameters.model_validate(overrides)
        except ValidationError as error:
            known = ", ".join(Parameters.model_fields)
            raise FitError(f"{self.name}: {error.errors()[0]['msg']}: {overrides}; it has {known}") from error

    def taps(self, parameters: Parameters) -> tuple[str, ...]:
        """Name the feature maps of the trunk that it reads."""
        return ("layer1",)

    def fit(
        self,
        nominal: Nominal,
        grid: Grid,
        parameters: Parameters,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Bank:
        """Learn the bank. Errors: FitError."""
        maps = nominal.features["layer1"]
        if len(maps) == 0 or not np.isfinite(maps).all():
            raise FitError(f"{self.name} needs presses with finite features, found {len(maps)} presses")
        deviation = np.maximum(maps.std(axis=0), np.float32(parameters.least_deviation))
        return Bank({"mean": maps.mean(axis=0), "deviation": deviation})

    def reference_score(
        self, features: Features, grid: Grid, bank: Bank, parameters: Parameters
    ) -> ScoreMaps:
        """Score as the graph does, in float64: the checks compare them. A detector may leave it out."""
        distance = features["layer1"].astype(np.float64) - bank.arrays["mean"]
        cells = np.sqrt(((distance / bank.arrays["deviation"]) ** 2).mean(axis=1))
        rows, columns = (large // small for large, small in zip(grid.frame, cells.shape[1:], strict=True))
        score_map = cells.repeat(rows, axis=1).repeat(columns, axis=2)
        return ScoreMaps(score_map, score_map.max(axis=(1, 2)))

    def head(self, grid: Grid, bank: Bank, parameters: Parameters) -> bytes:
        """Write the graph: the tap and the bank's arrays in, map and score of each press out."""
        import onnx.parser

        (c, h, w), (rows, columns) = grid.taps["layer1"], grid.frame
        graph = onnx.parser.parse_model(HEAD.format(c=c, h=h, w=w, rows=rows / h, columns=columns / w))
        return bytes(graph.SerializeToString())


# The language of `onnx.parser`: https://onnx.ai/onnx/repo-docs/Syntax.html. To a graph below opset 18 the
# fit can append neither the limit of a place's surroundings nor the check of missing relief.
HEAD = """<ir_version: 8, opset_import: ["": 18]>
head (float[n, {c}, {h}, {w}] layer1, float[{c}, {h}, {w}] mean, float[{c}, {h}, {w}] deviation)
    => (float[n, H, W] score_map, float[n] score)
<float[4] scales = {{1.0, 1.0, {rows}, {columns}}}, int64[1] channels = {{1}}, int64[2] places = {{1, 2}}> {{
    distance = Sub (layer1, mean)
    deviations = Div (distance, deviation)
    squares = Mul (deviations, deviations)
    square = ReduceMean (squares, channels)
    cells = Sqrt (square)
    pixels = Resize <mode = "nearest"> (cells, , scales)
    score_map = Squeeze (pixels, channels)
    score = ReduceMax <keepdims = 0> (score_map, places)
}}"""

plugin = Detector()
