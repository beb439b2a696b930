"""SPADE as published: the settings of the seed paper's scripts, and the defects of the releases.

Read against byungjae89/SPADE-pytorch @077c67b and the seed paper's scripts, which divide each descriptor by its length.
"""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from plugins.detectors.common.smoothing import PAPER_SIGMA_PX
from plugins.detectors.spade.parameters import LENGTH_FLOOR, SpadeParameters
from plugins.onnx_builder import Graph, Value

__all__ = ["PAPER", "REPAIRS", "PublishedSpade"]

# SPADE-pytorch src/main.py: the gallery (presses, columns, rows) is scanned in chunks of this many cells.
CHUNK = 100


class PublishedSpade(SpadeParameters):
    """The parameters with a switch for each published defect; off unless named."""

    is_floor_relative: bool = Field(
        default=True,
        description="the term that keeps a division by the length finite scales with the nominal length; false: 1e-6",
    )
    is_gallery_whole: bool = Field(
        default=True,
        description="search every gallery cell; false: only full chunks of 100, column by column, as SPADE-pytorch",
    )

    @model_validator(mode="after")
    def _chunks_need_no_window(self) -> Self:
        if not self.is_gallery_whole and self.window_mm is not None:
            raise ValueError(
                "is_gallery_whole=false leaves out cells of a search without window; set window_mm=null"
            )
        return self

    def length_floor(self, layer: NDArray[np.floating]) -> float:
        """Use one constant for all features, which changes faint ones."""
        return super().length_floor(layer) if self.is_floor_relative else LENGTH_FLOOR

    def gallery_rows(self, gallery: NDArray[np.floating]) -> NDArray[np.floating]:
        """Give the cells column by column, without those after the last complete chunk.

        A gallery smaller than one chunk is kept.
        """
        if self.is_gallery_whole:
            return super().gallery_rows(gallery)
        flat = gallery.swapaxes(1, 2).reshape(-1, gallery.shape[3])
        return flat if len(flat) < CHUNK else flat[: len(flat) // CHUNK * CHUNK]

    def emit_gallery_rows(self, graph: Graph, bank: Value, size: tuple[int, int, int]) -> Value:
        if self.is_gallery_whole:
            return bank
        h, w, width = size
        total = graph.op("Shape", bank, start=1, end=2)
        turned = graph.transpose(graph.reshape(bank, 0, -1, h, w, width), 0, 1, 3, 2, 4)
        shape = graph.op("Concat", graph.ints(0), total, graph.ints(width), axis=0)
        columns = graph.op("Reshape", turned, shape)
        whole = graph.op("Mul", graph.op("Div", total, graph.ints(CHUNK)), graph.ints(CHUNK))
        small = graph.op("Less", total, graph.ints(CHUNK))
        end = graph.op("Where", small, total, whole)
        return graph.op("Slice", columns, graph.ints(0), end, graph.ints(1))


PAPER = PublishedSpade(
    mode="paper",
    layers=("layer1", "layer2", "layer3"),
    regions=1,
    cell_mm=None,
    window_mm=None,
    dims=(),
    is_normalised=True,
    is_floor_relative=False,
    is_balanced=False,
    image_score="presses",
    is_touched_only=False,
    sigma=PAPER_SIGMA_PX,
    sigma_unit="px",
    is_sampled=False,
    packing="none",
    bank_mb=None,
)

REPAIRS = (
    "regions",
    "window_mm",
    "is_normalised",
    "is_floor_relative",
    "is_balanced",
    "image_score",
    "is_touched_only",
    "is_sampled",
)
"""The switches in which the corrected mode differs; the others are operating points."""
