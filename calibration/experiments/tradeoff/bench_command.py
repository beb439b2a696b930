"""The verb `bench`, and the page that it prints."""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.tradeoff.bench import STAGES, Measured, bench
from calibration.experiments.tradeoff.machine import busy

__all__ = ["bench_station", "page", "read_medians"]

SHOWN_PACKAGES: Final = 4


def bench_station(
    bundle: Annotated[Path, typer.Argument(help="the bundle that judges")],
    recording: Annotated[Path, typer.Argument(help="free frames, then presses, with labels")],
    presses: Annotated[int, typer.Option(help="presses that are timed", min=3)] = 100,
    idle: Annotated[
        float, typer.Option(help="seconds of each gateway in a process of its own", min=1)
    ] = 20.0,
    threads: Annotated[int, typer.Option(help="threads of the runtime", min=1, max=64)] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON, not a page")] = False,
    folder: Annotated[
        Path | None, typer.Option(help="where the database is made, on the disk that is measured")
    ] = None,
) -> None:
    """Measure a station, from frame to subscriber.

    Prints a page: each stage of a press beside the least that this machine can do, and what a
    gateway takes as a whole.
    """
    with tempfile.TemporaryDirectory(prefix="gelgate-bench-", dir=folder) as made:
        measured = bench(bundle, recording, presses, idle, threads, Path(made))
    typer.echo(json.dumps(summary(measured)) if as_json else page(measured), nl=as_json)


def summary(measured: Measured) -> dict[str, Any]:
    """Return the run with each stage as count, median, p95, p99, floor and ratio, in milliseconds."""
    stages = {
        name: _quantiles(values, measured.floors.get(name))
        for name, values in measured.stages.items()
        if values
    }
    return {**asdict(measured), "stages": stages}


def _quantiles(values: Sequence[float], floor: float | None) -> Mapping[str, float | None]:
    median, p95, p99 = (float(value) for value in np.percentile(values, (50, 95, 99)))
    ratio = median / floor if floor else None
    return {"count": len(values), "median": median, "p95": p95, "p99": p99, "floor": floor, "ratio": ratio}


def page(measured: Measured) -> str:
    """Return the page as Markdown."""
    return "\n".join(_lines(measured, summary(measured)["stages"])) + "\n"


def read_medians(page: str) -> dict[str, float]:
    """Read the median of each stage from a page, in milliseconds."""
    rows = ([cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines())
    cells = [row for row in rows if len(row) > 1]
    median = cells[0].index("median")
    return {row[0]: float(row[median]) for row in cells if row[0] in STAGES}


def _lines(measured: Measured, stages: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    machine, peak, frame = measured.machine, measured.peak, measured.frame
    yield "# Performance\n"
    yield (
        "A reference, printed by `gelgate lab bench`: what a press takes on one machine, and the least that it can "
        "take.\n"
    )
    yield (
        f"{machine['processor']}, {machine['cores']} cores, {machine['threads']} threads, {machine['system']}, Python "
        f"{machine['python']}, onnxruntime {machine['libraries']['onnxruntime']}; load at the start "
        f"{machine['load_at_start']:g}. {busy(machine)}\n"
    )
    yield (
        f"The bundle is {measured.bundle}. Frames {frame['width']:.0f}x{frame['height']:.0f}, "
        f"{frame['bytes'] / 1e3:.0f} kB, {frame['fps']:g} a second. "
        f"The machine does {peak['float32_per_s'] / 1e9:.0f} GFLOP/s in float32, "
        f"{peak['int8_per_s'] / 1e9:.0f} Gop/s in int8, and copies {peak['bytes_per_s'] / 1e9:.1f} GB/s.\n"
    )
    heading = ["milliseconds", "what", "count", "median", "p95", "p99", "floor", "ratio"]
    yield markdown_table(heading, [_cells(name, stages[name]) for name in STAGES if name in stages])
    yield markdown_table(["a gateway in a process of its own", ""], list(_whole(measured)))
    yield (
        "Floors: entropy decoding of a whole frame, the arithmetic or the bytes of trunk and head at the rates above,\n"
        "and the fastest flush of a page of this disk; a verdict and an outbox have the sum. A stage may stay below\n"
        "its floor where it reads a part of a frame, or was done ahead. Bare trunk and bare flush run\n"
        "between the presses."
    )


def _whole(measured: Measured) -> Iterator[list[str]]:
    """The rows of what a gateway takes as a whole."""
    idle, pressing, sensor = measured.idle, measured.pressing, measured.sensor_share
    if idle is not None:
        share = idle.core_share
        yield ["looks at the free gel", f"{100 * share:.1f} % of one core"]
        yield ["that without the simulated sensor", f"{100 * max(0.0, share - sensor):.1f} % of one core"]
    if pressing is not None and pressing.press_cpu_ms is not None:
        of_sensor = pressing.press_cpu_ms * min(1.0, sensor / pressing.core_share)
        yield [
            "processor time of a press, with the free gel after it",
            f"{pressing.press_cpu_ms:.0f} ms, {of_sensor:.0f} of them the simulated sensor's",
        ]
    if pressing is not None:
        memory = f"{pressing.memory_bytes / 1e6:.0f} MB"
        start = f"{pressing.start_s:.2f} s, at least {pressing.warm_up_s:.2f} of them frames of the free gel"
        if bare := measured.bare:
            memory += f", {bare.memory_bytes / 1e6:.0f} of them its packages and the trunk"
            start += f" and {bare.imports_s:.2f} imports of its packages"
        yield ["memory at its peak, with presses", memory]
        yield ["start to `ready`", start]
    yield ["the help, from start to end", f"{measured.help_s:.2f} s"]
    sizes = list(measured.packages.items())
    total = sum(package.installed for _, package in sizes)
    yield ["packages that it needs, installed", f"{total / 1e6:.0f} MB"]
    for name, package in sizes[:SHOWN_PACKAGES]:
        in_memory = f", {package.in_memory / 1e6:.0f} MB of it in memory" if pressing else ""
        yield [f"of that {name}", f"{package.installed / 1e6:.0f} MB{in_memory}"]


def _cells(name: str, stage: Mapping[str, float | None]) -> list[str]:
    numbers = ("median", "p95", "p99", "floor", "ratio")
    cells = ["" if (value := stage[key]) is None else f"{value:.3g}" for key in numbers]
    return [name, STAGES[name], f"{stage['count']}", *cells]
