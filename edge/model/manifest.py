"""The manifest of a bundle: the content of `manifest.json`, checked field by field when it is read.

Units: bytes, milliseconds and seconds are in the names; pixel positions are in the picture (origin top left).
"""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from edge.core.detector import Grid, Mode
from edge.core.drawn_regions import DrawnRegions
from edge.core.imaging.quality import NominalContact, NominalStrength
from edge.core.imaging.region import Region
from edge.core.imaging.sensor_check import NominalColours
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.imaging.tiles import Tiles
from edge.core.verdict import Verdict, decide
from edge.model.manifest_files import (
    MAX_ARRAY_BYTES,
    MAX_BUNDLE_BYTES,
    ArrayEntry,
    Count,
    DotsEntry,
    Entry,
    FileEntry,
    Name,
    PicturesEntry,
    RegistrationEntry,
    Side,
)

__all__ = [
    "REGION_WEIGHTS",
    "SCHEMA_VERSION",
    "ArrayEntry",
    "BackboneEntry",
    "ColourEntry",
    "CostCard",
    "DotsEntry",
    "Facts",
    "FileEntry",
    "GoldenEntry",
    "GridEntry",
    "Manifest",
    "Provenance",
    "RatePromise",
    "ThresholdEntry",
    "ToleranceEntry",
]

SCHEMA_VERSION = 1
"""Increased when a reader of the last version would misread the new one; a newer bundle is refused."""


MAX_REVISION = 2**63 - 1
"""The largest integer of the gateway's database."""

REGION_WEIGHTS = "region_weights"
"""The array of the bank by which a score map is multiplied, (h, w), where a person has drawn regions."""


class BackboneEntry(Entry):
    """The trunk, known by the SHA-256 of its file. `in_bundle` is false where it is found in the gateway's store."""

    id: Name
    trunk: FileEntry
    in_bundle: bool = True


class TilesEntry(Entry):
    """`edge.core.imaging.tiles.Tiles` over the region. untouched: tiles that no nominal press touches, row by row."""

    size: Side
    rows: tuple[Annotated[int, Field(ge=0, le=8192)], ...]
    columns: tuple[Annotated[int, Field(ge=0, le=8192)], ...]
    untouched: tuple[int, ...] = ()

    @classmethod
    def of(cls, tiles: Tiles, untouched: tuple[int, ...] = ()) -> "TilesEntry":
        return cls(size=tiles.size, rows=tiles.rows, columns=tiles.columns, untouched=untouched)

    def tiles(self, frame: tuple[int, int]) -> Tiles:
        return Tiles(frame, self.size, self.rows, self.columns)


class GridEntry(Entry):
    """`edge.core.detector.Grid`: the geometry that the head was built for. Taps are (channels, h, w).

    tiles: set where the trunk sees the region in overlapping tiles.
    """

    frame: tuple[Side, Side]
    taps: dict[str, tuple[Annotated[int, Field(ge=1, le=65536)], Side, Side]]
    pixels_per_mm: float = Field(gt=0)
    tiles: TilesEntry | None = None

    @model_validator(mode="after")
    def _laid_out(self) -> "GridEntry":
        for tap, shape in self.taps.items():
            if 4 * math.prod(shape) > MAX_ARRAY_BYTES:
                raise ValueError(f"the tap '{tap}' of {shape} needs more than {MAX_ARRAY_BYTES} bytes")
        if self.tiles is None:
            return self
        count = len(self.tiles.tiles(self.frame))
        if any(not 0 <= index < count for index in self.tiles.untouched):
            raise ValueError(f"untouched tiles are numbered 0 to {count - 1}, found {self.tiles.untouched}")
        for tap, (_, h, w) in self.taps.items():
            if h % len(self.tiles.rows) or w % len(self.tiles.columns):
                raise ValueError(f"the tap '{tap}' of {h}x{w} is not a mosaic of complete tiles")
        return self

    @classmethod
    def of(cls, grid: Grid, untouched: tuple[int, ...] = ()) -> "GridEntry":
        return cls(
            frame=grid.frame,
            taps=dict(sorted(grid.taps.items())),
            pixels_per_mm=grid.pixels_per_mm,
            tiles=None if grid.tiles is None else TilesEntry.of(grid.tiles, untouched),
        )

    def grid(self) -> Grid:
        tiles = None if self.tiles is None else self.tiles.tiles(self.frame)
        return Grid(self.frame, self.taps, self.pixels_per_mm, tiles)


class RatePromise(Entry):
    """An exact binomial limit: after `alarms` in `trials` at most `rate` of trials alarm, with this confidence."""

    trials: int = Field(ge=1)
    alarms: int = Field(ge=0)
    rate: float = Field(ge=0, le=1)
    confidence: float = Field(gt=0, lt=1)


class ThresholdEntry(Entry):
    """A press fails when its score is above `value`.

    alpha: the requested false-alarm rate. alpha_floor: 1 / (pieces + 1), the smallest rate that presses of this number
    of pieces can guarantee, as a mean over bundles. pieces: the number of pieces; a press of an unknown piece counts as
    one. rate_range: the range of this bundle's own rate, with a probability of 95 %. nominal_scores: rising;
    of each press the higher of two, by a bank without it and by the final bank. by_press, by_piece: the limit of this
    bundle's own rate, where a piece alarms with any of its presses; by_piece is None where each press counts as a
    piece, and where fewer than four were held out: then alpha_floor is 1, for nothing is promised of new pieces.
    method: how the value was found, in words; `edge.model.manifest_facts` states the guarantee.
    """

    value: float
    method: str
    alpha: float = Field(gt=0, lt=1)
    alpha_floor: float = Field(gt=0, le=1)
    nominal_scores: tuple[float, ...]
    pieces: int | None = Field(default=None, ge=1)
    rate_range: tuple[float, float] | None = None
    by_press: RatePromise | None = None
    by_piece: RatePromise | None = None

    @property
    def n(self) -> int:
        return len(self.nominal_scores)

    @property
    def is_floored(self) -> bool:
        """True where there were nominal presses of fewer pieces than the requested rate needs."""
        return self.alpha < self.alpha_floor


class ToleranceEntry(Entry):
    """The allowed difference from a score computed at fit: `score` and `score_map` absolute, plus `relative` of the
    expected value. `measured` is the largest difference found at fit over runs, threads and batch sizes."""

    score: float = Field(ge=0)
    score_map: float = Field(ge=0)
    relative: float = Field(ge=0)
    measured: float = Field(ge=0)

    def around(self, score: float) -> float:
        """The allowed difference from a score of this size."""
        return self.score + self.relative * abs(score)


class GoldenEntry(Entry):
    """A frame that is scored again at load.

    score: the expected anomaly score. map_peaks: the expected score map as the maxima of 8 x 8 equal blocks, row by
    row; a digest of the map's bytes would differ between processors within the tolerance.
    """

    image: FileEntry
    what: str
    score: float
    map_peaks: tuple[tuple[float, ...], ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _even(self) -> "GoldenEntry":
        if len({len(row) for row in self.map_peaks}) != 1 or not self.map_peaks[0]:
            raise ValueError("the rows of map_peaks have one length, at least 1")
        return self


Level = Annotated[float, Field(ge=0, le=255)]


class ColourEntry(Entry):
    """`NominalColours`: the coarse colours of nominal presses, by which other sensors are refused.

    cells: rows of columns of (r, g, b) over the region, levels. limit: the `colour_distance` at which a press is
    refused. spread: the largest between a nominal press and the others. Both are fractions of the light.
    """

    cells: tuple[tuple[tuple[Level, Level, Level], ...], ...]
    limit: float = Field(gt=0)
    spread: float = Field(ge=0)

    @model_validator(mode="after")
    def _even(self) -> "ColourEntry":
        if len({len(row) for row in self.cells}) != 1:
            raise ValueError("the colours' rows have one length, and there is at least one row")
        self.nominal()
        return self

    def nominal(self) -> NominalColours:
        return NominalColours(np.array(self.cells, np.float64), self.limit)


class CostCard(Entry):
    """The time and size of scoring and fitting, on the machine of the fit. Milliseconds are medians of one frame.

    features_s: trunk over all presses, and registration. fit_s: the bank from the features. threshold_s: the folds for
    the threshold. In seconds of processor time; of fits before 0.2.0 by the clock.
    """

    trunk_ms: float
    head_ms: float
    threads: Count
    features_s: float
    fit_s: float
    threshold_s: float
    bank_bytes_stored: Count
    bank_bytes_unpacked: Count


class Provenance(Entry):
    """Where the bundle comes from. `created` is a date given by the caller; `presses` names every nominal press,
    `left_out` those that were given and left out by name."""

    created: str
    presses: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    seed: int | None = None
    versions: dict[str, str] = Field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Facts(Entry):
    """The manifest without the list of files."""

    schema_version: Literal[1] = 1
    """1. A newer one is refused by name: update the gateway."""
    part: Name
    """The part."""
    position: Name
    """The place on the part that is pressed."""
    revision: int | None = Field(default=None, ge=1, le=MAX_REVISION)
    """Rises with every fit of this position; absent in bundles before 0.2.0 and in wrapped ones. A gateway
    refuses one that is lower than that in use: docs/security.md#an-older-bundle."""
    method: Name
    """The detector."""
    mode: Mode | None = None
    """`paper` or `corrected`."""
    parameters: dict[str, Any] = Field(default_factory=dict)
    """The settings of the detector."""
    repairs: tuple[str, ...] = ()
    """The corrections of the published method."""
    facts: dict[str, Any] = Field(default_factory=dict)
    """What the fit learnt or chose: rank, ridge, weights of the backbone; how `free_gel` was estimated, what
    `dots` of a marker gel were found; `detectability`, the smallest damage found by place
    (docs/studies.md#probability-of-detection); the `gel` of the presses, where `--gel` named it; of a carried
    bundle the old one's identity, `carried_from`."""
    profile: SensorProfile
    """How camera bytes became pictures: border, size, scale, camera controls. A gateway that reads in another
    way is refused."""
    region: Region
    """The inspected rectangle of the picture."""
    grid: GridEntry | None = None
    """The taps with their shapes, for which the head was built; with tiles, their layout and those that no
    nominal press touches."""
    threshold: ThresholdEntry
    """A press fails above `value`. `alpha` is the requested rate of false alarms, `alpha_floor` the smallest
    that presses of this number of `pieces` can guarantee, `rate_range` the range of this bundle's own rate,
    `by_press` and `by_piece` the rate that it exceeds in one case of ten at most."""
    tolerance: ToleranceEntry
    """The allowed difference from a score computed at fit; `measured` is the difference found at fit."""
    contact: NominalContact | None = None
    """Where nominal presses touch: centroid and area, as fractions of the picture."""
    strength: NominalStrength | None = None
    """How strong their imprints are: lowest, middle and highest, levels; null where the free gel was not
    seen."""
    colours: ColourEntry | None = None
    """The coarse colours of nominal presses, and how much a press may differ:
    docs/bundle.md#another-sensor."""
    dots: DotsEntry | None = None
    """The dots of a marker gel in pixels of the region, which are filled before anything else
    (docs/detectors.md#marker-gels). `largest`: the area of the largest in discs of the usual width."""
    is_smoothed: bool = False
    """Of each press, its dots filled, each pixel becomes the mean of 3x3 by the weights 1, 2, 1 across and
    down, the border repeated, halves rounded up (docs/detectors.md#noise). The bundle's own pictures are
    smoothed already."""
    regions: DrawnRegions | None = None
    """What a person has drawn: polygons in mm with name, kind and factor (docs/limits.md#drawn-regions)."""
    cost: CostCard | None = None
    """Measured on the machine of the fit."""
    accuracy: dict[str, float] | None = None
    """Where labelled presses were available."""
    provenance: Provenance
    """Date, presses, seed, versions, warnings."""


class Manifest(Facts):
    """The complete manifest of a bundle.

    Either `backbone`, `head` and `bank` (a trunk, a small graph and arrays), or only `detector`: a single graph from
    frames to score map, such as a third party's, whose bank has at most the weights of drawn regions.
    """

    backbone: BackboneEntry | None = None
    """The trunk: file, SHA-256, bytes; `in_bundle` is false where it was left out."""
    head: FileEntry | None = None
    """The graph after the trunk."""
    detector: FileEntry | None = None
    """The single graph of a third party's detector."""
    bank: dict[str, ArrayEntry] = Field(default_factory=dict)
    """Per array: `dtype` and `shape` in use, `packing` as stored, files."""
    golden: tuple[GoldenEntry, ...] = ()
    """Per frame: its content, its score, and the maxima of 8 x 8 blocks of its map."""
    free_gel: FileEntry | None = None
    """The region without contact, where tiles may be skipped: docs/detectors.md#large-frames."""
    free_view: FileEntry | None = None
    """The whole gel without contact, 160x120: a gateway that starts while something presses notices it by
    this picture."""
    registration: RegistrationEntry | None = None
    """How a press is brought to the pose of the bank (docs/detectors.md#parts-that-lie-anywhere): pictures of
    the region, one of them of the limits of the gel, the colours of slopes, whether the part has a turn, and
    below which limits a press is rejected; absent where presses are scored as they lie."""
    nominal_pictures: PicturesEntry | None = None
    """What people are shown beside a press that does not pass (docs/operations.md#why-a-press-fails): at most
    64 pictures of 160 pixels, one below the other, or one mean of 320; absent in old bundles. No score depends
    on them."""

    @model_validator(mode="after")
    def _whole(self) -> "Manifest":
        pair = self.backbone is not None and self.head is not None and self.grid is not None
        arrays = self.bank.keys() - {REGION_WEIGHTS}  # the gateway reads it too
        single = self.detector is not None and not (self.backbone or self.head or arrays)
        if pair == single or (pair and self.detector is not None):
            raise ValueError("a bundle has either backbone, head and grid, or a single detector graph")
        if self.grid is not None and self.grid.frame != self.frame:
            raise ValueError(f"the head is built for {self.grid.frame}, the region is {self.frame} (h, w)")
        is_skipping = (
            self.grid is not None and self.grid.tiles is not None and bool(self.grid.tiles.untouched)
        )
        if is_skipping and pair and self.free_gel is None:
            raise ValueError(
                "tiles that are skipped need the picture free_gel, whose features replace theirs"
            )
        if (size := sum(file.size_bytes for file in self.files)) > MAX_BUNDLE_BYTES:
            raise ValueError(f"the files have {size} bytes together, at most {MAX_BUNDLE_BYTES} are read")
        weights = self.bank.get(REGION_WEIGHTS)
        if (self.regions is None) != (weights is None) or (weights and weights.shape != self.frame):
            raise ValueError(f"drawn regions and the array {REGION_WEIGHTS} of {self.frame} belong together")
        if not self.region.is_within(self.profile.size):
            raise ValueError(f"region {self.region} is outside the picture of {self.profile.size}")
        return self

    def decide(self, score: float) -> Verdict:
        """The verdict on a score, by this bundle's threshold and tolerance. Errors: NotScorable."""
        return decide(score, self.threshold.value, self.tolerance.around(score))

    @property
    def frame(self) -> tuple[int, int]:
        """(h, w) of the inspected region."""
        return self.region.height, self.region.width

    @property
    def files(self) -> tuple[FileEntry, ...]:
        """Every file that the bundle must hold, in the order in which they are checked."""
        trunk = [self.backbone.trunk] if self.backbone and self.backbone.in_bundle else []
        graphs = [graph for graph in (self.head, self.detector) if graph]
        arrays = [f for a in self.bank.values() for f in (a.data, a.scale) if f]
        gel = [picture for picture in (self.free_gel, self.free_view) if picture]
        registered = self.registration.files if self.registration else ()
        pictures = [self.nominal_pictures.file] if self.nominal_pictures else []
        return (*trunk, *graphs, *arrays, *(g.image for g in self.golden), *gel, *registered, *pictures)
