"""The graphs of imported detectors, each by the definition of the program that trained it.

All of them end alike: raw distances are enlarged to the model's input and blurred, the score is taken there, and the
map is drawn in the frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from edge.core.arrays import F64
from edge.core.detector import Grid
from edge.core.errors import ConfigError
from plugins.detectors.common.batched_nearest import PRODUCT_LIMIT, HalvedBank
from plugins.detectors.common.descriptor import Descriptor
from plugins.detectors.common.embedding import Embedding
from plugins.detectors.common.smoothing import Border, Upsampling, smoothing_matrix, upsampling_matrix
from plugins.detectors.padim.fit import emit_squared
from plugins.onnx_builder import Graph, Value

__all__ = ["Framing", "MapSteps", "dfkde_head", "dfm_head", "padim_head", "patchcore_head"]


@dataclass(frozen=True)
class Framing:
    """The way from frames (h, w) to the model's input, resize and centre crop, and the way back for its maps.

    Ref: torch's bilinear interpolation with half-pixel centres; torchvision's Resize and CenterCrop.
    """

    frame: tuple[int, int]
    resize: tuple[int, int] | None = None
    """(h, w) to resize to, None keeps the frame."""
    crop: tuple[int, int] | None = None
    """(h, w) of the middle that remains, None keeps all."""
    is_antialiased: bool = True

    def __post_init__(self) -> None:
        resized = self.resize or self.frame
        if min(*resized, *(self.crop or resized)) < 1 or max(resized) > 4096:
            raise ConfigError(
                f"a picture of {resized} and a crop of {self.crop} (h, w) cannot be a model's input"
            )
        if self.crop and (self.crop[0] > resized[0] or self.crop[1] > resized[1]):
            raise ConfigError(
                f"the model crops {self.crop} out of {resized} (h, w), which is smaller; give a larger --region"
            )

    @property
    def size(self) -> tuple[int, int]:
        """(h, w) of the model's input."""
        return self.crop or self.resize or self.frame

    @property
    def is_plain(self) -> bool:
        """True where the model sees the frame without resize and crop."""
        return self.size == self.frame and (self.resize or self.frame) == self.frame

    @property
    def seen(self) -> float:
        """The part of the frame that the model sees, 0 to 1."""
        resized = self.resize or self.frame
        return self.size[0] * self.size[1] / (resized[0] * resized[1])

    def back(self, axis: int) -> F64:
        """Draw one axis of a map of the input in the frame: (frame pixels, input pixels). Beyond the crop nothing is
        seen, and the map is 0, the lowest distance."""
        count, resized = self.size[axis], (self.resize or self.frame)[axis]
        first = round((resized - count) / 2)
        matrix = upsampling_matrix(resized, self.frame[axis])
        seen = matrix[:, first : first + count].copy()
        seen[:, 0] += matrix[:, :first].sum(axis=1)
        seen[:, -1] += matrix[:, first + count :].sum(axis=1)
        seen[matrix[:, first : first + count].sum(axis=1) < 0.5] = 0
        return seen


@dataclass(frozen=True)
class MapSteps:
    """From raw distances to map and score."""

    framing: Framing
    sigma_px: float
    """The standard deviation of the blur, in pixels of the model's input."""
    upsampling: Upsampling = "bilinear"
    border: Border = "symmetric"

    def emit(self, graph: Graph, raw: Value, cells: tuple[int, int], score: Value | None = None) -> None:
        """The head's outputs from raw distances (n, rows, columns).

        score: (n,), else the maximum of the model's map.
        """
        rows, columns = (
            smoothing_matrix(n, pixels, self.sigma_px, self.upsampling, self.border)
            for n, pixels in zip(cells, self.framing.size, strict=True)
        )
        smooth = graph.between(rows, raw, columns)
        if score is None:
            score = graph.op("ReduceMax", smooth, graph.ints(1, 2), keepdims=0)
        if not self.framing.is_plain:
            smooth = graph.between(self.framing.back(0), smooth, self.framing.back(1))
        graph.output("score_map", smooth, ("n", *self.framing.frame))
        graph.output("score", score, ("n",))


def padim_head(embedding: Embedding, ridge: float, steps: MapSteps) -> bytes:
    """PaDiM: the Mahalanobis distance of every cell.

    Bank: `mean` (cells, d), `basis` (cells, r, d), `weights` (cells, r).
    """
    graph = Graph("padim")
    width = embedding.width
    delta = graph.op("Sub", embedding.emit(graph), graph.input("mean", (embedding.count, width)))
    basis = graph.input("basis", ("cells", "rank", width))
    squared = emit_squared(graph, delta, basis, graph.input("weights", ("cells", "rank")), 1, ridge)
    raw = graph.reshape(graph.op("Sqrt", squared), -1, *embedding.cells)
    steps.emit(graph, raw, embedding.cells)
    return graph.serialise()


def patchcore_head(
    descriptor: Descriptor, grid: Grid, rows: int, neighbours: int, is_squared: bool, steps: MapSteps
) -> bytes:
    """PatchCore: the distance to the nearest row of `bank` (rows, d), both minus `mean` (d,).

    neighbours: rows around the nearest one by which the score is weighted, 1 for the largest distance alone.
    """
    graph = Graph("patchcore")
    (h, w), width = descriptor.cells(grid), descriptor.width(grid)
    columns = descriptor.emit(graph, grid, None)
    mean = graph.unsqueeze(graph.input("mean", (width,)), 1)
    patches = graph.transpose(graph.op("Sub", columns, mean), 0, 2, 1)
    bank = graph.input("bank", (rows, width))
    raw = HalvedBank(graph, bank).search(patches, (h * w, width), PRODUCT_LIMIT // rows)
    if is_squared:
        raw = graph.op("Mul", raw, raw)
    score = graph.op("ReduceMax", raw, graph.ints(1), keepdims=0)
    if neighbours > 1:
        score = graph.op("Mul", score, _weight(graph, patches, raw, bank, min(neighbours, rows)))
    steps.emit(graph, graph.reshape(raw, -1, h, w), (h, w), score)
    return graph.serialise()


def _weight(graph: Graph, patches: Value, raw: Value, bank: Value, neighbours: int) -> Value:
    """anomalib's weight (n,): 1 minus the share of the nearest row in a softmax over the distances of the most
    anomalous patch to the rows around that row."""
    top = graph.op("ArgMax", raw, axis=1, keepdims=1)
    patch = graph.op("GatherND", patches, top, batch_dims=1)
    nearest = _closest(graph, patch, bank, 1)
    around = _closest(graph, graph.squeeze(graph.op("Gather", bank, nearest, axis=0), 1), bank, neighbours)
    difference = graph.op("Sub", graph.op("Gather", bank, around, axis=0), graph.unsqueeze(patch, 1))
    apart = graph.length(difference, 2)
    share = graph.first(graph.op("Softmax", apart, axis=1), 1)
    return graph.op("Sub", graph.scalar(1.0), share)


def _closest(graph: Graph, queries: Value, bank: Value, count: int) -> Value:
    """The numbers (n, count) of the rows of the bank that are closest to queries (n, d), nearest first."""
    half = graph.op("Mul", graph.op("ReduceSumSquare", bank, graph.ints(1), keepdims=0), graph.scalar(0.5))
    closeness = graph.op("Sub", graph.op("MatMul", queries, graph.transpose(bank, 1, 0)), half)
    return graph.ops("TopK", 2, closeness, graph.ints(count), axis=1)[1]


def dfm_head(
    tap: str, grid: Grid, pool: int, components: int, kind: Literal["fre", "nll"], steps: MapSteps
) -> bytes:
    """DFM: the part of the pooled features outside the principal directions (`fre`, with a map), or their Gaussian
    negative log likelihood (`nll`, whose map is the score everywhere)."""
    graph = Graph("dfm")
    c, h, w = grid.taps[tap]
    x = graph.input(tap, ("n", c, h, w))
    if pool > 1:
        x = graph.op("AveragePool", x, kernel_shape=[pool, pool], strides=[pool, pool])
    h, w = h // pool, w // pool
    flat = graph.op("Sub", graph.reshape(x, 0, c * h * w), graph.input("mean", (c * h * w,)))
    vectors = graph.input("vectors", (components, c * h * w))
    along = graph.op("MatMul", flat, graph.transpose(vectors, 1, 0))
    if kind == "nll":
        scaled = graph.op(
            "MatMul",
            graph.op("Sub", along, graph.input("centre", (components,))),
            graph.input("whitening", (components, "kept")),
        )
        score = graph.op(
            "Add", graph.op("ReduceSumSquare", scaled, graph.ints(1), keepdims=0), graph.input("offset", (1,))
        )
        emit_constant_map(graph, score, steps.framing)
        return graph.serialise()
    off = graph.op("Sub", flat, graph.op("MatMul", along, vectors))
    squared = graph.reshape(graph.op("Mul", off, off), 0, c, h, w)
    raw = graph.op("ReduceSum", squared, graph.ints(1), keepdims=0)
    steps.emit(graph, raw, (h, w), graph.op("ReduceSum", raw, graph.ints(1, 2), keepdims=0))
    return graph.serialise()


def dfkde_head(
    taps: Sequence[str], grid: Grid, sizes: tuple[int, int], is_unit: bool, framing: Framing
) -> bytes:
    """DFKDE: the logit of the anomaly probability, 0.05 (12 - log density), as a score without saturation.

    sizes: principal components and rows of `dataset`. is_unit: projections are divided by their own length.
    """
    graph = Graph("dfkde")
    components, rows = sizes
    (tap,) = taps
    c, h, w = grid.taps[tap]
    pooled = graph.op("ReduceMean", graph.input(tap, ("n", c, h, w)), graph.ints(2, 3), keepdims=0)
    flat = graph.op("Sub", pooled, graph.input("mean", (c,)))
    along = graph.op("MatMul", flat, graph.transpose(graph.input("vectors", (components, c)), 1, 0))
    if is_unit:
        length = graph.op("Sqrt", graph.op("ReduceSumSquare", along, graph.ints(1), keepdims=1))
        along = graph.op("Div", along, graph.op("Max", length, graph.scalar(1e-12)))
    scaled = graph.op("MatMul", along, graph.input("bandwidth", (components, components)))
    dataset = graph.input("dataset", (rows, components))
    difference = graph.op("Sub", graph.unsqueeze(scaled, 1), dataset)
    squared = graph.op("ReduceSumSquare", difference, graph.ints(2), keepdims=0)
    log = graph.op("ReduceLogSumExp", graph.op("Mul", squared, graph.scalar(-0.5)), graph.ints(1), keepdims=0)
    density = graph.op("Add", log, graph.input("log_norm", (1,)))
    score = graph.op("Mul", graph.op("Sub", graph.scalar(12.0), density), graph.scalar(0.05))
    emit_constant_map(graph, score, framing)
    return graph.serialise()


def emit_constant_map(graph: Graph, score: Value, framing: Framing) -> None:
    """The outputs of a method that says how anomalous a press is and not where: the score at every pixel."""
    spread = graph.op("Expand", graph.unsqueeze(score, 1, 2), graph.ints(1, *framing.frame))
    graph.output("score_map", spread, ("n", *framing.frame))
    graph.output("score", score, ("n",))
