"""One run: every point fitted and scored, timed with all others, and written as rows."""

import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.experiments.harness.rows import ROW_FORMAT, ROWS_FILE, Rows
from calibration.experiments.tradeoff.accuracy import Truth, measure_accuracy
from calibration.experiments.tradeoff.fitting import FittedPoint, content_sha256, fit_points
from calibration.experiments.tradeoff.floor import Work, floor_ms
from calibration.experiments.tradeoff.front import WAITED, Row, read_rows, write_rows
from calibration.experiments.tradeoff.machine import best, fingerprint, probe
from calibration.experiments.tradeoff.memory import peak_bytes
from calibration.experiments.tradeoff.plan import LEAST_ROUNDS, Run, RunSettings
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.presses import Chosen, on_common_grid, see
from calibration.experiments.tradeoff.timing import Lane, Samples, bundle_lanes, camera_frames, measure_rounds
from calibration.progress import Show
from calibration.threads import one_blas_thread
from edge.core.errors import ConfigError
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle_writer import write_bundle

__all__ = ["measure", "read_or_measure", "require_same_run", "stage_times"]

Others = Callable[[Run, Mapping[str, Sequence[CameraFrame]]], list[tuple[Row, Lane]]]
"""Gives rows without times, and what is timed for them; camera frames are by the name of their profile."""

CAMERA_FRAMES: Final = 3
"""Different presses that are decoded and scored while timing."""


def read_or_measure(
    run: Run,
    output: Path,
    overwrite: bool,
    show: Show,
    say: Callable[[str], None],
    others: Others = lambda run, frames: [],
) -> list[Row]:
    """Return the rows of the folder, measured where it has none.

    others: gives what else is timed with the points. Errors: as `measure`; ConfigError for rows of another run.
    """
    file = output / ROWS_FILE
    for sentence in run.chosen.remarks():
        say(sentence)
    if file.is_file() and not overwrite:
        rows = read_rows(file)
        require_same_run(rows, run, file)
        say(f"{file} holds {len(rows)} points; --overwrite measures them again")
        return rows
    if not run.chosen.high:
        say("no high-resolution pictures of these presses: one resolution is measured")
    rows = measure(run, output / "unfinished", show, others)
    write_rows(file, rows)
    shutil.rmtree(output / "unfinished", ignore_errors=True)  # the bundles and the journal
    return rows


@one_blas_thread()
def measure(run: Run, folder: Path, show: Show, others: Others = lambda run, frames: []) -> list[Row]:
    """Measure every point and give its row; points that the folder already holds are not fitted again.

    Times are always measured together, so an interrupted timing starts again. folder: is made; holds bundles until
    the end. Errors: FitError, ConfigError (the folder holds another run), GelgateError (disk).
    """
    begun = time.perf_counter()
    points, settings, chosen = run.points, run.settings, run.chosen
    machine, dataset = fingerprint(settings.threads), chosen.sha256()
    _claim(folder, settings, dataset)
    finished = Rows(folder / "points.jsonl")
    with finished.hold():
        _fit_missing(run, folder, finished, show)
    found = {row["key"]: row for row in finished.read()}
    rows = [found[point.key] for point in points]
    bundles = [folder / "bundles" / point.key for point in points]
    with show("peak memory", len(points)) as advance:
        memory = peak_bytes(bundles, settings.threads, advance)
    frames = _frames(points, chosen)
    trunks = [row["trunk_sha256"] for row in rows]
    lanes = bundle_lanes(points, bundles, trunks, frames, settings.threads)
    for row, most in zip(rows, memory, strict=True):
        row["peak_memory_bytes"] = most
    for row, lane in others(run, frames):
        rows.append(row)
        lanes.append(lane)
    before = probe(settings.threads)
    times = _time(lanes, settings, begun, show)
    peak = best(before, probe(settings.threads))
    common = {
        "part": chosen.part,
        "position": chosen.position,
        "seed": settings.seed,
        "scored": {"good": int((~chosen.label).sum()), "defective": int(chosen.label.sum())},
        "dataset_sha256": dataset,
        "machine": machine,
        "peak": asdict(peak),
    }
    for row, columns in zip(rows, times, strict=True):
        floor, binds = floor_ms(Work(**row["work"]), peak)
        row |= {**columns, "floor": {"ms": floor, "binds": binds}, **common}
    return rows


def require_same_run(rows: Sequence[Row], run: Run, file: Path) -> None:
    """Check finished rows. Errors: ConfigError where presses, seed or points are not those wanted now."""
    keys = {row["key"] for row in rows if not row.get("peer")}
    points = {point.key for point in run.points}
    wanted = {"presses": run.chosen.sha256(), "seed": run.settings.seed, "points": points}
    found = {"presses": rows[0]["dataset_sha256"], "seed": rows[0]["seed"], "points": keys}
    other = [name for name in wanted if wanted[name] != found[name]]
    if other:
        raise ConfigError(
            f"'{file}' has rows of another run ({', '.join(other)} differ); measure again with --overwrite, choose "
            "another folder with --output, or draw these rows with `python -m calibration.experiments.tradeoff.figure "
            f"{file} FILE.svg`"
        )


def _claim(folder: Path, settings: RunSettings, dataset: str) -> None:
    """Mark a folder as this run's. Errors: ConfigError where it holds another one."""
    own = {"seed": settings.seed, "replicates": settings.replicates}
    wanted = {"format": ROW_FORMAT, "dataset": dataset, **own}
    path = folder / "run.json"
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_file() and json.loads(path.read_text()) != wanted:
        raise ConfigError(
            f"'{folder}' holds an unfinished run with other presses or another seed; remove it, or choose another "
            "folder with --output"
        )
    path.write_text(json.dumps(wanted))


def _fit_missing(run: Run, folder: Path, rows: Rows, show: Show) -> None:
    """Fit and score every point without a row, view by view and backbone by backbone."""
    missing = [point for point in run.points if point.key not in rows.done()]
    if not missing:
        return
    with show("operating points", len(run.points)) as advance:
        for fitted in _fit(missing, run.chosen, run.settings):
            _write_point(fitted, folder / "bundles")
            rows.append(_accuracy_row(fitted, run.truth))
            advance(len(rows.done()))


def _fit(points: Iterable[OperatingPoint], chosen: Chosen, settings: RunSettings) -> Iterator[FittedPoint]:
    def group_key(point: OperatingPoint) -> tuple[int, str]:
        return list(VIEWS).index(point.view), point.backbone

    for view, of_view in groupby(sorted(points, key=group_key), key=lambda point: point.view):
        seen = see(chosen, VIEWS[view])
        for _, group in groupby(of_view, key=group_key):
            yield from fit_points(list(group), chosen, seen, threads=settings.threads, seed=settings.seed)


def _write_point(fitted: FittedPoint, folder: Path) -> None:
    """Write the point's bundle, and its trunk once for all points that share it."""
    trunk = folder / "trunks" / f"{fitted.trunk.sha256}.onnx"
    trunk.parent.mkdir(parents=True, exist_ok=True)
    if not trunk.is_file():
        trunk.write_bytes(fitted.trunk.graph)
    write_bundle(folder / fitted.point.key, fitted.files, overwrite=True)


def _accuracy_row(fitted: FittedPoint, truth: Truth) -> Row:
    """Return what does not depend on the machine's speed, and the seconds of the fit."""
    point, manifest = fitted.point, fitted.manifest
    assert manifest.backbone is not None
    return {
        "format": ROW_FORMAT,
        "key": point.key,
        "method": point.method,
        "mode": point.mode,
        "backbone": point.backbone,
        "view": point.view,
        "settings": dict(point.settings),
        "presses": point.presses,
        "gel_share": point.presses / DEFAULT_LIMIT_PRESSES,
        "accuracy": measure_accuracy([on_common_grid(m) for m in fitted.maps], fitted.scores, truth),
        "bank_bytes": sum(entry.bytes_stored for entry in manifest.bank.values()),
        "bank_bytes_unpacked": sum(entry.bytes_unpacked for entry in manifest.bank.values()),
        "trunk_bytes": manifest.backbone.trunk.size_bytes,
        "trunk_sha256": manifest.backbone.trunk.sha256,
        "content_sha256": content_sha256(manifest),
        "fit_s": {"features": fitted.features_s, "bank": fitted.bank_s},
        "work": asdict(fitted.work),
    }


def _time(lanes: Sequence[Lane], settings: RunSettings, begun: float, show: Show) -> list[Row]:
    with show("rounds of timing", settings.rounds) as advance:
        samples = measure_rounds(
            lanes,
            rounds=settings.rounds,
            least=LEAST_ROUNDS,
            seed=settings.seed,
            until=begun + 60 * settings.minutes,
            advance=advance,
        )
    return stage_times(samples)


def _frames(points: Sequence[OperatingPoint], chosen: Chosen) -> dict[str, list[CameraFrame]]:
    """Camera frames of the last scored presses, which are defective, by the name of the profile."""
    views = {VIEWS[point.view].profile_name: VIEWS[point.view] for point in points}
    last = replace(chosen, fitted=chosen.fitted[:1], scored=chosen.scored[-CAMERA_FRAMES:])
    return {name: camera_frames(view, see(last, view).frames) for name, view in views.items()}


def stage_times(samples: Samples) -> list[dict[str, Any]]:
    """Return the columns with the times of every point.

    Medians are pooled over points, so a percentile is the median and how far above their median the point's own rounds
    reach.
    """
    ms = _medians(samples.stages, samples.groups)
    tails = np.percentile(samples.stages, 95, axis=1) - np.median(samples.stages, axis=1)
    return [
        {
            "stages": {
                name: {"median": float(ms[stage, k]), "p95": float(ms[stage, k] + tails[stage, k])}
                for stage, name in enumerate(WAITED)
            },
            "rounds": samples.stages.shape[1],
        }
        for k in range(samples.groups.shape[1])
    ]


def _medians(values: NDArray[np.float64], groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the median of each stage and point over rounds, (stages, points), pooled over points of one group."""
    found = np.empty((values.shape[0], values.shape[2]))
    for stage, of_point in enumerate(groups):
        for group in np.unique(of_point):
            found[stage, of_point == group] = np.median(values[stage][:, of_point == group])
    return found
