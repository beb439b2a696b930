"""A third party's detector graph is adapted to the gateway's contract: what its input expects, which outputs it has.

    frames uint8 (n, h, w, 3) -> steps -> the graph -> score_map float32 (n, h, w) of the region, score float32 (n,)

What the file shows is found: layout, type, size, a normalisation at its start, anomalib's export by its names. What it
does not show is asked for. Scores that anomalib limits to 0..1 are taken before that. The adapted graph is compared
with the original at its input, map and score.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.arrays import F64, U8
from edge.core.errors import ConfigError
from edge.model.pipe import FRAMES, SCORE, SCORE_MAP
from export.normalised_scores import SUFFIX, Normalisation, constants, raw_scores
from export.onnx_values import PIXELS, PictureInput, append, load_model, picture_input, read_frames, run_each
from export.parity import ParityReport, Stage, compare, order_stage
from plugins.backbones.input_steps import IMAGENET, InputSteps, linear_matrix
from plugins.onnx_builder import Graph

__all__ = ["Adapted", "GraphInput", "adapt"]

PLAIN = InputSteps((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
ANOMALIB = frozenset({"anomaly_map", "pred_score"}), frozenset({"pred_label", "pred_score"})
LABELS = {"pred_score": "pred_label", "anomaly_map": "pred_mask"}
MAP_NAMES = ("score_map", "anomaly_map", "anomaly_maps", "map", "heatmap")
SCORE_NAMES = ("score", "pred_score", "anomaly_score", "image_score")
MOST_COMPARED = 4


@dataclass(frozen=True)
class GraphInput:
    """What the caller states about a graph; None where it is to be found.

    mean, std: others, of RGB in 0..1. map_output, score_output: names of outputs.
    """

    scale: str | None = None
    """`0..1`, `0..255`, or `imagenet` (0..1, then ImageNet's mean and std)."""
    mean: tuple[float, float, float] | None = None
    std: tuple[float, float, float] | None = None
    map_output: str | None = None
    score_output: str | None = None
    is_negated: bool = False
    """Lower scores are more anomalous in the graph."""


@dataclass(frozen=True)
class Adapted:
    """The adapted graph."""

    graph: bytes
    found: dict[str, str]
    """What was found or stated of the original, for the manifest."""
    parity: ParityReport | None
    """The comparison; None where the graph met the contract already and is unchanged."""


def adapt(data: bytes, frames: U8, given: GraphInput | None = None, where: str = "the graph") -> Adapted:
    """Adapt a graph to frames of one size. frames: nominal ones, uint8 (n, h, w, 3); at least one.

    Errors: ConfigError for a graph that cannot be used, or where something must be stated, with the option.
    """
    given = given or GraphInput()
    model = load_model(data, where)
    inputs, given_outputs = ([one.name for one in side] for side in (model.graph.input, model.graph.output))
    if inputs == [FRAMES] and {SCORE_MAP, SCORE} <= set(given_outputs) and given == GraphInput():
        return Adapted(data, {"input": "frames, as the gateway gives them"}, None)
    picture = picture_input(model, where)
    frame = (frames.shape[1], frames.shape[2])
    steps, high, why = _scaling(model, picture, given, where)
    if picture.size is not None and picture.size != frame:
        steps = replace(steps, size=picture.size)
    shown = frames[:: max(1, len(frames) // MOST_COMPARED)][:MOST_COMPARED]
    pixels = picture.prepare(shown, steps, high)
    model, normalised = raw_scores(model, LABELS)
    data = bytes(model.SerializeToString()) if normalised else data
    names = [output.name for output in model.graph.output]
    outputs = dict(zip(names, run_each(data, names, picture.name, pixels, picture.batch, where), strict=True))
    chosen = _Outputs.of(outputs, given, where)
    sign = -1.0 if given.is_negated else 1.0
    body = read_frames(model, picture, steps, frame, high)
    kept = {name: name for name in (chosen.map, chosen.score) if name}
    merged = append(body, _end(chosen, outputs, frame, sign), kept)
    merged.graph.name = "adapted"
    graph = bytes(merged.SerializeToString())
    facts = {
        "input": f"{picture.name}, {picture.layout}, {'uint8' if picture.is_bytes else 'float32'}, {why}",
        "preprocessing": steps.words,
        "outputs": f"map {chosen.map}, score {chosen.score or 'the largest value of the map'}",
        **_describe_normalisation(normalised, sign),
    }
    expected = sign * chosen.maps(outputs, frame), sign * chosen.scores(outputs, sign)
    before = [  # each original output against the raw one, normalised by the stated formula
        Stage(f"normalised {name}", outputs[name + SUFFIX], how.apply(outputs[name]), "score")
        for name, how in normalised.items()
    ]
    return Adapted(graph, facts, _compare(graph, shown, pixels, expected, facts, picture, where, before))


def _describe_normalisation(normalised: Mapping[str, Normalisation], sign: float) -> dict[str, str]:
    """Say what is done with normalised outputs that are taken raw."""
    facts = {}
    if normalised:
        facts["normalisation"] = f"left out: {'; '.join(n.words for n in normalised.values())}"
    own = normalised["pred_score"].own_threshold if "pred_score" in normalised else None
    if own is not None:
        value = f"{sign * own:.7g}"
        facts["threshold of the model"] = f"{value} of raw scores; --threshold {value} takes it"
    return facts


def _scaling(
    model: Any, picture: PictureInput, given: GraphInput, where: str
) -> tuple[InputSteps, float, str]:
    """The steps, the value of full brightness, and how they are known. Errors: ConfigError where they are not."""
    if given.scale or given.mean or given.std:
        return _read_scale(given)
    if picture.is_bytes:
        return PLAIN, 255.0, "levels 0 to 255 (its type)"
    names = {output.name for output in model.graph.output}
    if any(names >= usual for usual in ANOMALIB):
        return PLAIN, 1.0, "0..1 (an export of anomalib, which normalises inside)"
    inside = _normalisation(model, picture.name)
    if inside is not None:
        return (
            PLAIN,
            255.0 if inside > 2 else 1.0,
            f"{'0..255' if inside > 2 else '0..1'} (it normalises inside)",
        )
    raise ConfigError(
        f"{where} does not say how its input '{picture.name}' is scaled; pass --input 0..1, --input 0..255 or --input "
        "imagenet, or --mean and --std, as in the program that trained it"
    )


def _read_scale(given: GraphInput) -> tuple[InputSteps, float, str]:
    scales = {"0..1": (PLAIN, 1.0), "0..255": (PLAIN, 255.0), "imagenet": (IMAGENET, 1.0)}
    if given.scale is not None and given.scale not in scales:
        raise ConfigError(f"--input is {', '.join(scales)}; found '{given.scale}'")
    steps, high = scales[given.scale or "0..1"]
    if given.mean or given.std:
        if high != 1.0:
            raise ConfigError("--mean and --std are of RGB in 0..1: leave --input 0..255 away")
        steps = replace(steps, mean=given.mean or steps.mean, std=given.std or steps.std)
    return steps, high, f"{given.scale or 'mean and std'} (stated)"


def _normalisation(model: Any, start: str) -> float | None:
    """The largest constant of three colours that is subtracted or divided right behind the input, None without one."""
    stored, at = constants(model), start
    for _ in range(4):
        readers = [node for node in model.graph.node if at in node.input]
        if len(readers) != 1:
            return None
        if readers[0].op_type in ("Sub", "Div", "Mul", "Add"):
            others = [stored[name] for name in readers[0].input if name in stored]
            if others and others[0].size == 3:
                return float(np.abs(others[0]).max())
        elif readers[0].op_type not in ("Identity", "Cast", "Resize", "Transpose"):
            return None
        at = readers[0].output[0]
    return None


@dataclass(frozen=True)
class _Outputs:
    """The chosen outputs."""

    map: str
    score: str
    """Empty where the map's largest value is the score."""

    @classmethod
    def of(cls, outputs: Mapping[str, NDArray[Any]], given: GraphInput, where: str) -> "_Outputs":
        """Choose map and score. Errors: ConfigError where there is no map, or more than one that may be it."""
        listed = ", ".join(f"{name} {array.dtype} {array.shape}" for name, array in outputs.items())
        for name in filter(None, (given.map_output, given.score_output)):
            if name not in outputs:
                raise ConfigError(f"{where} has no output '{name}'; it has {listed}")
        maps = [name for name, array in outputs.items() if _is_map(array)]
        scores = [name for name, array in outputs.items() if _is_score(array)]
        chosen = given.map_output or _one(maps, MAP_NAMES)
        if chosen is None or not _is_map(outputs[chosen]):
            raise ConfigError(
                f"{where} has the outputs {listed}; a gateway needs a score map of floats, (n, h, w) or (n, 1, h, w): "
                "choose one with --map-output, or export the network with its map"
            )
        score = given.score_output or _one(scores, SCORE_NAMES)
        if score is not None and not _is_score(outputs[score]):
            raise ConfigError(f"{where}: the output '{score}' is not one float per frame; it has {listed}")
        if score is None and scores:
            raise ConfigError(f"{where} has the scores {', '.join(scores)}; choose with --score-output")
        return cls(chosen, score or "")

    def maps(self, outputs: Mapping[str, NDArray[Any]], frame: tuple[int, int]) -> F64:
        """(n, h, w) at the frame's size, in NumPy."""
        array = outputs[self.map].astype(np.float64)
        small = array.reshape(len(array), *_map_size(array))
        rows, columns = (linear_matrix(a, b) for a, b in zip(small.shape[1:], frame, strict=True))
        return np.asarray(rows @ small @ columns.T, np.float64)

    def scores(self, outputs: Mapping[str, NDArray[Any]], sign: float) -> F64:
        if self.score:
            return outputs[self.score].astype(np.float64).reshape(-1)
        flat = outputs[self.map].astype(np.float64).reshape(len(outputs[self.map]), -1)
        return np.asarray(sign * (sign * flat).max(axis=1), np.float64)


def _one(names: Sequence[str], usual: Sequence[str]) -> str | None:
    """The only name, or the first usual one."""
    return names[0] if len(names) == 1 else next((name for name in usual if name in names), None)


def _is_map(array: NDArray[Any]) -> bool:
    if array.dtype.kind != "f" or array.ndim not in (3, 4) or min(_map_size(array)) <= 1:
        return False
    return array.ndim == 3 or 1 in (array.shape[1], array.shape[3])


def _map_size(array: NDArray[Any]) -> tuple[int, int]:
    axes = (
        array.shape[1:] if array.ndim == 3 else (array.shape[2:] if array.shape[1] == 1 else array.shape[1:3])
    )
    return axes[0], axes[1]


def _is_score(array: NDArray[Any]) -> bool:
    return array.dtype.kind == "f" and array.ndim >= 1 and array.size == array.shape[0]


def _end(chosen: _Outputs, outputs: Mapping[str, NDArray[Any]], frame: tuple[int, int], sign: float) -> bytes:
    """The graph from the chosen outputs to `score_map` in the frame's size and `score`."""
    graph = Graph("end")
    array = outputs[chosen.map]
    x = graph.input(
        chosen.map, ("n", *array.shape[1:]), "float16" if array.dtype == np.float16 else "float32"
    )
    h, w = _map_size(array)
    x = graph.op("Cast", graph.reshape(x, -1, h, w), to=1)
    if chosen.score:
        score = graph.reshape(graph.input(chosen.score, ("n", *outputs[chosen.score].shape[1:])), -1)
        score = graph.op("Mul", score, graph.scalar(sign))
    x = graph.op("Mul", x, graph.scalar(sign)) if sign != 1 else x
    if not chosen.score:
        score = graph.op("ReduceMax", x, graph.ints(1, 2), keepdims=0)
    if (h, w) != frame:
        rows, columns = (linear_matrix(a, b) for a, b in zip((h, w), frame, strict=True))
        x = graph.between(rows, x, columns)
    graph.output(SCORE_MAP, x, ("n", *frame))
    graph.output(SCORE, score, ("n",))
    return graph.serialise()


def _compare(
    graph: bytes,
    frames: U8,
    pixels: NDArray[Any],
    expected: tuple[F64, F64],
    facts: dict[str, str],
    picture: PictureInput,
    where: str,
    before: Sequence[Stage],
) -> ParityReport:
    values = [f"front/{PIXELS}", SCORE_MAP, SCORE]
    arrays = run_each(graph, values, FRAMES, frames, picture.batch, where)
    # Where frames are resized and rounded to bytes, either side may round a half the other way.
    level = 2 / 255 if picture.is_bytes else None
    stages = [
        Stage("input", pixels, arrays[0], "input", level),
        *before,
        Stage("map", expected[0], arrays[1], "map", level),
        Stage("score", expected[1], arrays[2], "score", level),
        order_stage(expected[1], arrays[2]),
    ]
    return compare(stages, frames=frames, title=f"{where} and its bundle", facts=facts)
