"""One run: every point fitted and scored, timed with all others, and written as rows."""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Final

from calibration.experiments.harness.rows import ROW_FORMAT, ROWS_FILE, Rows
from calibration.experiments.tradeoff.fitting import fit_points
from calibration.experiments.tradeoff.floor import Work, floor_ms
from calibration.experiments.tradeoff.front import Row, read_rows, write_rows
from calibration.experiments.tradeoff.machine import best, fingerprint, probe
from calibration.experiments.tradeoff.memory import peak_bytes
from calibration.experiments.tradeoff.plan import LEAST_ROUNDS, Run
from calibration.experiments.tradeoff.point import VIEWS, OperatingPoint
from calibration.experiments.tradeoff.timing import (
    Lane,
    bundle_lanes,
    camera_frames,
    measure_rounds,
    stage_times,
)
from calibration.folders import claim
from calibration.progress import Show
from calibration.threads import one_blas_thread
from edge.core.errors import ConfigError
from edge.core.imaging.frames import CameraFrame

__all__ = ["measure", "read_or_measure", "require_same_run"]

Frames = Mapping[tuple[int, int], Sequence[CameraFrame]]
"""Camera frames, by the size of their profile."""

Others = Callable[[Run, Frames], list[tuple[Row, Lane]]]
"""Gives rows without times, and what is timed for them."""

CAMERA_FRAMES: Final = 3
"""Different presses that are decoded and scored while timing, which are defective."""


def read_or_measure(
    run: Run, show: Show, say: Callable[[str], None], others: Others = lambda run, frames: []
) -> list[Row]:
    """Return the rows of the output folder, measured where it has none.

    others: gives what else is timed with the points. Errors: as `measure`; ConfigError for rows of another run.
    """
    output = run.given.output
    file = output / ROWS_FILE
    for sentence in run.chosen.every.remarks:
        say(sentence)
    if file.is_file() and not run.given.overwrite:
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
    given, chosen, bundles = run.given, run.chosen, folder / "bundles"
    machine, dataset = fingerprint(given.threads), chosen.sha256()
    stamp = {"format": ROW_FORMAT, "dataset": dataset, "seed": given.seed, "replicates": given.bootstrap}
    way_on = "remove it, or choose another folder with --output"
    claim(folder, "run.json", stamp, "unfinished run", ConfigError, way_on)
    rows = _fit_missing(run, folder, show)
    with show("peak memory", len(rows)) as advance:
        memory = peak_bytes([bundles / row["key"] for row in rows], given.threads, advance)
    for row, most in zip(rows, memory, strict=True):
        row["peak_memory_bytes"] = most
    frames = {
        view.profile.size: camera_frames(view.profile, chosen.show(chosen.scored[-CAMERA_FRAMES:], view))
        for view in map(VIEWS.__getitem__, {point.view for point in run.points})
    }
    lanes = bundle_lanes(rows, bundles, frames, given.threads)
    for row, lane in others(run, frames):
        rows.append(row)
        lanes.append(lane)
    before = probe(given.threads)
    with show("rounds of timing", given.rounds) as advance:
        until = begun + 60 * given.minutes
        ms = measure_rounds(
            lanes, rounds=given.rounds, least=LEAST_ROUNDS, seed=given.seed, until=until, advance=advance
        )
    peak = best(before, probe(given.threads))
    common = {
        "part": chosen.every.part,
        "position": chosen.every.position,
        "seed": given.seed,
        "scored": {"good": int((~chosen.label).sum()), "defective": int(chosen.label.sum())},
        "dataset_sha256": dataset,
        "machine": machine,
        "peak": asdict(peak),
    }
    for row, columns in zip(rows, stage_times(ms, [lane.shared for lane in lanes]), strict=True):
        floor, binds = floor_ms(Work(**row["work"]), peak)
        row |= {**columns, "floor": {"ms": floor, "binds": binds}, **common}
    return rows


def require_same_run(rows: Sequence[Row], run: Run, file: Path) -> None:
    """Check finished rows. Errors: ConfigError where presses, seed or points are not those wanted now."""
    keys = {row["key"] for row in rows if not row.get("peer")}
    points = {point.key for point in run.points}
    wanted = {"presses": run.chosen.sha256(), "seed": run.given.seed, "points": points}
    row_facts = {"presses": rows[0]["dataset_sha256"], "seed": rows[0]["seed"], "points": keys}
    other = [name for name in wanted if wanted[name] != row_facts[name]]
    if other:
        raise ConfigError(
            f"'{file}' has rows of another run ({', '.join(other)} differ); measure again with --overwrite, choose "
            "another folder with --output, or draw these rows with `python -m calibration.experiments.tradeoff.figure "
            f"{file} FILE.svg`"
        )


def _fit_missing(run: Run, folder: Path, show: Show) -> list[Row]:
    """Fit and score every point without a row, view by view and backbone by backbone; return the rows of all."""
    journal = Rows(folder / "points.jsonl")

    def group_key(point: OperatingPoint) -> tuple[int, str]:
        return list(VIEWS).index(point.view), point.backbone

    with journal.hold(), show("operating points", len(run.points)) as advance:
        missing = [point for point in run.points if point.key not in journal.done()]
        for _, group in groupby(sorted(missing, key=group_key), group_key):
            for row in fit_points(list(group), run, folder / "bundles"):
                journal.append(row)
                advance(len(journal.done()))
    rows_by_key = {row["key"]: row for row in journal.read()}
    return [rows_by_key[point.key] for point in run.points]
