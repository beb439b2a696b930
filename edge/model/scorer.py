"""Scoring: frames in, score map and score out; features stay inside onnxruntime between the two graphs.

The trunk writes its taps into buffers that the head reads; the bank is bound once. There is no code for a particular
method. `edge.model.tile_runner` runs a tiled trunk and skips tiles that show only free gel.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from edge.core.errors import BundleCorrupt, NotScorable, PoseNotFound
from edge.core.registration.pose import Registered, gel_limits_in_pose
from edge.model.bundle import Bundle
from edge.model.pipe import FRAMES, RELIEF_MAP, SCORE, SCORE_MAP, Pipe, Ran
from edge.model.session import RUNTIME_ERRORS, TrunkSessions, open_session

if TYPE_CHECKING:
    from edge.model.tile_runner import FreeGel, TileRunner

__all__ = ["Scored", "Scorer", "map_peaks"]

MAP_BLOCKS = 8
"""A golden score map is stored as the maxima of this many blocks along each side."""

# onnxruntime's names of the dtypes that a bank may hold.
ORT_TYPES = {
    "float32": "tensor(float)",
    "int64": "tensor(int64)",
    "bool": "tensor(bool)",
    "uint8": "tensor(uint8)",
}


@dataclass(frozen=True)
class Scored:
    """One scored press; higher scores are more anomalous. Times are each frame's share of its batch."""

    score_map: NDArray[np.float32]
    """(h, w) of the region, raw."""
    anomaly_score: float
    """Raw."""
    trunk_ms: float
    """Time in the trunk; 0 for a single graph, which counts as head."""
    head_ms: float
    registered: Registered | None = None
    """The press in the bank's pose; None for a bundle without registration."""
    registration_ms: float = 0.0
    relief_map: NDArray[np.float32] | None = None
    """What the map shows of missing relief alone, in the bank's pose; None where that is not asked for."""


class Scorer:
    """A bundle that is ready to score. Use it from one thread at a time.

    trunks: sessions to share between bundles. is_skipping: False runs every tile of a tiled trunk on every press.
    Errors: BundleCorrupt where a graph cannot be opened, lacks a tap, needs an array that the bank lacks, or gives
    another shape.
    """

    def __init__(
        self,
        bundle: Bundle,
        threads: int = 2,
        trunks: TrunkSessions | None = None,
        *,
        is_skipping: bool = True,
    ) -> None:
        self.bundle = bundle
        self.frame = bundle.manifest.frame
        self._where = bundle.where
        self._trunks = trunks or TrunkSessions(threads)
        self._trunk: ort.InferenceSession | None = None
        sha256 = bundle.trunk_sha256
        if sha256 is None:
            graph = bundle.graphs.detector or b""
        else:
            self._trunk = self._trunks.get(sha256, bundle.graphs.trunk, f"bundle {self._where}: trunk.onnx")
            graph = bundle.graphs.head or b""
        self._head_name = "detector.onnx" if self._trunk is None else "head.onnx"
        self._head = open_session(graph, threads, f"bundle {self._where}: {self._head_name}")
        self._taps = self._check_taps()
        self._bank = {
            name: ort.OrtValue.ortvalue_from_numpy(np.ascontiguousarray(bundle.bank[name]).reshape(shape))
            for name, shape in self._check_bank().items()
        }
        self._runner: TileRunner | None = None
        self._free: FreeGel | None = None
        self._open_tiles(is_skipping)
        self._pipe = self._open_pipe()
        self._registrar = None if bundle.registration is None else bundle.registration.open()
        self._beside: tuple[Mapping[str, ort.OrtValue], Pipe] | None = None
        manifest, free = bundle.manifest, bundle.manifest.free_gel
        # Bundles with equal ones compute the same features of a press.
        pose = manifest.registration and manifest.registration.model_copy(update={"gel_limits": None})
        self._trunk_facts = (
            sha256,
            manifest.grid,
            manifest.dots,
            manifest.is_smoothed,
            pose,
            free and free.sha256,
        )

    def score(self, rgb: NDArray[np.uint8]) -> Scored:
        """Score one press of the inspected region as the camera shows it. Errors as `score_prepared`."""
        return self.score_prepared(self.bundle.prepare(rgb))

    def score_prepared(self, rgb: NDArray[np.uint8]) -> Scored:
        """Score one press of the inspected region as `Bundle.prepare` returns it. rgb: uint8 (h, w, 3).

        A bundle with registration brings it to the bank's pose first; the map is then of the press again, and places
        that the bank does not know, or that have left the field, count neither for the score nor in the map. Errors:
        PoseNotFound; NotScorable when the answer is not finite, ValueError for another shape or dtype.
        """
        if self._registrar is None:
            return self.score_in_pose(rgb)
        start = time.perf_counter()
        registered = self._registrar.register(rgb)
        registration_ms = (time.perf_counter() - start) * 1e3
        if registered.refusal is not None:
            raise PoseNotFound(registered.refusal)
        scored = self.score_in_pose(registered.rgb)
        return replace(_bring_back(scored, registered), registration_ms=registration_ms)

    def score_beside(self, other: "Scorer", rgb: NDArray[np.uint8], registered: Registered | None) -> Scored:
        """Score a press that `other` has just scored: by its pose and its features, where this bundle would find the
        same. rgb, registered: as for `score_prepared`, and as `other` has registered it. Errors as `score_prepared`."""
        if self._trunk is None or self._trunk_facts != other._trunk_facts:
            return self.score_prepared(rgb)
        in_pose = rgb if registered is None else registered.rgb
        features = other._pipe.find_features(in_pose)
        if features is None or not self._taps.keys() <= features.keys():
            scored = self.score_in_pose(in_pose)
        else:
            scored = self._score_features(features)
        if registered is None or self.bundle.registration is None:
            return scored
        limits = self.bundle.registration.gel_limits
        in_pose_limits = None if limits is None else gel_limits_in_pose(limits, registered.pose)
        return _bring_back(scored, replace(registered, gel_limits=in_pose_limits))

    def _score_features(self, features: Mapping[str, ort.OrtValue]) -> Scored:
        """Score the features of one frame. Errors: NotScorable."""
        if self._beside is None or self._beside[0] is not features:
            shape = (1, *self.frame, 3)
            parts = self._trunk, self._head, self._taps, self._bank, shape
            pipe = Pipe(*parts, features=features, outputs=self._outputs)
            self._beside = features, pipe
        return self._check_scores(self._beside[1].run_head)[0]

    def copy(self) -> "Scorer":
        """Make another, which another thread may use; they share the trunk."""
        return Scorer(self.bundle, self._trunks.threads, self._trunks)

    def score_in_pose(self, rgb: NDArray[np.uint8]) -> Scored:
        """Score one frame that lies as the bank's presses do, without registration. Errors as `score_batch`."""
        return self.score_batch(rgb[None])[0]

    def score_batch(self, frames: NDArray[np.uint8]) -> list[Scored]:
        """Score n frames that lie as the bank's presses do in one run of the graphs. frames: uint8 (n, h, w, 3).

        Errors: NotScorable when an answer is not finite, ValueError for another shape or dtype.
        """
        expected = (*self.frame, 3)
        if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[1:] != expected or len(frames) == 0:
            raise ValueError(
                f"bundle {self._where} scores uint8 {expected} frames (h, w, 3), "
                f"found {frames.dtype} {frames.shape[1:]}"
            )
        if len(frames) != self._pipe.size:
            self._pipe = self._new_pipe(len(frames))
        return self._check_scores(lambda: self._pipe.run(frames))

    def _check_scores(self, run: Callable[[], Ran]) -> list[Scored]:
        """Run, and return what was scored. Errors: NotScorable where it fails, or is not finite."""
        try:
            (score_maps, scores, *more), trunk_ms, head_ms = run()
        except RUNTIME_ERRORS as error:
            raise NotScorable(f"bundle {self._where} gave no score: {error!s:.300}") from error
        if not (np.isfinite(score_maps).all() and np.isfinite(scores).all()):
            raise NotScorable(
                f"bundle {self._where} gave a score that is not finite; the press counts as an error"
            )
        share, relief = 1 / len(scores), more[0] if more else [None] * len(scores)
        return [
            Scored(score_map, float(score), trunk_ms * share, head_ms * share, relief_map=relief_map)
            for score_map, score, relief_map in zip(score_maps, scores, relief, strict=True)
        ]

    def check_golden(self) -> float:
        """Score every golden frame again; returns the largest score difference found.

        Errors: BundleCorrupt when a score or a map is outside the manifest's tolerance.
        """
        return max(
            (self.check_golden_frame(number) for number in range(len(self.bundle.golden))), default=0.0
        )

    def check_golden_frame(self, number: int) -> float:
        """Score one golden frame again; returns the difference of its score. Errors as `check_golden`."""
        golden, tolerance = self.bundle.golden[number], self.bundle.manifest.tolerance
        try:
            scored = self.score_in_pose(golden.rgb)
        except NotScorable as error:
            raise BundleCorrupt(
                f"bundle {self._where}: golden frame {number} has no score: {error}"
            ) from error
        difference = abs(scored.anomaly_score - golden.score)
        allowed = tolerance.around(golden.score)
        if difference > allowed:
            raise BundleCorrupt(
                f"bundle {self._where}: golden frame {number} ({golden.what}) scores {scored.anomaly_score:.6g}, "
                f"expected {golden.score:.6g} within {allowed:.2g}; this machine computes it differently, fit again"
            )
        self._check_golden_map(number, scored, np.asarray(golden.map_peaks))
        return difference

    def _check_golden_map(self, number: int, scored: Scored, expected: NDArray[np.float64]) -> None:
        tolerance, peaks = self.bundle.manifest.tolerance, np.asarray(map_peaks(scored.score_map))
        if peaks.shape != expected.shape:
            raise BundleCorrupt(
                f"bundle {self._where}: golden map {number} is {expected.shape}, found {peaks.shape}"
            )
        beyond = np.abs(peaks - expected) - (tolerance.score_map + tolerance.relative * np.abs(expected))
        if beyond.max() > 0:
            row, column = np.unravel_index(int(beyond.argmax()), beyond.shape)
            raise BundleCorrupt(
                f"bundle {self._where}: the score map of golden frame {number} differs in block ({row}, {column}): "
                f"{peaks[row, column]:.6g}, expected {expected[row, column]:.6g}; fit again on this kind of machine"
            )

    def _check_taps(self) -> dict[str, tuple[int, int, int]]:
        """Return the taps that the head reads, with their shapes; empty for a single graph."""
        if self._trunk is None or self.bundle.grid is None:
            self._check_frames_input(self._head, self._head_name)
            return {}
        self._check_frames_input(self._trunk, "trunk.onnx")
        given = {output.name for output in self._trunk.get_outputs()}
        taps = {
            i.name: self.bundle.grid.taps[i.name]
            for i in self._head.get_inputs()
            if i.name in self.bundle.grid.taps
        }
        missing = sorted(set(taps) - given)
        if missing or not taps:
            raise BundleCorrupt(
                f"bundle {self._where}: head.onnx reads the taps {sorted(taps)}, trunk.onnx gives {sorted(given)}; "
                "export with a trunk that has them"
            )
        return taps

    def _check_frames_input(self, session: ort.InferenceSession, name: str) -> None:
        inputs = {i.name: i for i in session.get_inputs()}
        if list(inputs) != [FRAMES] or inputs[FRAMES].type != ORT_TYPES["uint8"]:
            listed = ", ".join(f"{i.name} {i.type}" for i in inputs.values())
            raise BundleCorrupt(
                f"bundle {self._where}: {name} has inputs {listed}, expected one, '{FRAMES}' uint8 (n, h, w, 3)"
            )

    def _check_bank(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the bank arrays that the head reads."""
        outputs = {output.name for output in self._head.get_outputs()}
        if not {SCORE_MAP, SCORE} <= outputs:
            raise BundleCorrupt(
                f"bundle {self._where}: {self._head_name} gives {sorted(outputs)}, expected '{SCORE_MAP}' and '{SCORE}'"
            )
        if self._trunk is None:
            return {}
        wanted = {i.name: i for i in self._head.get_inputs() if i.name not in self._taps}
        for name, entry in wanted.items():
            array = self.bundle.bank.get(name)
            if array is None:
                raise BundleCorrupt(
                    f"bundle {self._where}: head.onnx wants the input '{name}', the bank has "
                    f"{sorted(self.bundle.bank) or 'no arrays'}; fit again"
                )
            if entry.type != ORT_TYPES.get(array.dtype.name) or not _fits(array.shape, entry.shape):
                raise BundleCorrupt(
                    f"bundle {self._where}: head.onnx wants '{name}' as {entry.type} {entry.shape}, the bank has "
                    f"{array.dtype} {array.shape}; fit again"
                )
        return {name: self.bundle.bank[name].shape for name in wanted}

    def _open_tiles(self, is_skipping: bool) -> None:
        """Bind a tiled trunk to one tile, and compute the features for tiles without contact."""
        grid, entry = self.bundle.grid, self.bundle.manifest.grid
        if self._trunk is None or grid is None or grid.tiles is None or entry is None or entry.tiles is None:
            return
        from edge.model.tile_runner import FreeGel, TileRunner  # most trunks have no tiles

        try:
            self._runner = TileRunner(self._trunk, grid.tiles, self._taps)
            if is_skipping and entry.tiles.untouched and self.bundle.free_gel is not None:
                self._free = FreeGel(self._runner, self.bundle.free_gel, entry.tiles.untouched)
        except RUNTIME_ERRORS as error:
            raise BundleCorrupt(
                f"bundle {self._where}: trunk.onnx does not run on tiles of {grid.tiles.size}: {error!s:.300}"
            ) from error

    def _open_pipe(self) -> Pipe:
        """Bind buffers for one frame and try a grey frame, so a wrong shape is found before the first press."""
        pipe = self._new_pipe(1)
        try:
            (score_maps, scores, *_), _, _ = pipe.run(np.full((1, *self.frame, 3), 128, np.uint8))
        except RUNTIME_ERRORS as error:
            raise BundleCorrupt(
                f"bundle {self._where}: its graphs do not run on a frame of {self.frame} (h, w): {error!s:.300}"
            ) from error
        expected = (1, *self.frame)
        is_number = scores.dtype in (np.float32, np.float64)
        if (
            score_maps.shape != expected
            or scores.shape != (1,)
            or score_maps.dtype != np.float32
            or not is_number
        ):
            raise BundleCorrupt(
                f"bundle {self._where}: {self._head_name} gives score_map {score_maps.dtype} {score_maps.shape} "
                f"and score {scores.dtype} {scores.shape}, expected float32 {expected} and float32 "
                "(1,); export it again"
            )
        return pipe

    def _new_pipe(self, size: int) -> Pipe:
        mosaics = None if self._runner is None else self._runner.mosaics(size, self._free)
        parts = self._trunk, self._head, self._taps, self._bank, (size, *self.frame, 3)
        return Pipe(*parts, mosaics, outputs=self._outputs)

    @property
    def _outputs(self) -> Sequence[str]:
        """What is asked of the head: missing relief by itself where its peak may lie where a press is not seen."""
        is_apart = self.bundle.registration is not None and RELIEF_MAP in {
            output.name for output in self._head.get_outputs()
        }
        return (SCORE_MAP, SCORE, RELIEF_MAP) if is_apart else (SCORE_MAP, SCORE)


def _bring_back(scored: Scored, registered: Registered) -> Scored:
    """Bring what was scored in the bank's pose back to the press."""
    score_map = scored.score_map
    if scored.relief_map is not None:
        score_map = registered.show_missing(score_map, scored.relief_map)
    return replace(
        scored,
        score_map=registered.in_press(score_map),
        anomaly_score=registered.score(score_map),
        registered=registered,
        relief_map=None,
    )


def _fits(shape: tuple[int, ...], wanted: list[Any]) -> bool:
    """Tell whether a shape agrees with a graph input's, whose free sizes are names or None."""
    return len(shape) == len(wanted) and all(
        not isinstance(size, int) or size == n for n, size in zip(shape, wanted, strict=True)
    )


def map_peaks(score_map: NDArray[np.float32]) -> tuple[tuple[float, ...], ...]:
    """The maxima of 8 x 8 blocks of a score map, row by row; fewer where the map has fewer pixels."""
    h, w = score_map.shape
    rows = np.linspace(0, h, min(MAP_BLOCKS, h) + 1).astype(int)[:-1]
    columns = np.linspace(0, w, min(MAP_BLOCKS, w) + 1).astype(int)[:-1]
    peaks = np.maximum.reduceat(np.maximum.reduceat(score_map, rows, axis=0), columns, axis=1)
    return tuple(tuple(float(value) for value in row) for row in peaks)
