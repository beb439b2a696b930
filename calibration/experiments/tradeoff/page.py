"""A run for people, from rows alone: a page, one HTML file with everything inside, and the front as lines of text."""

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.tradeoff.accuracy import MEASURES
from calibration.experiments.tradeoff.front import DIGITS, MARGIN, WAITED, list_front, verdict_ms
from calibration.experiments.tradeoff.machine import busy
from calibration.experiments.tradeoff.point import VIEWS
from calibration.experiments.tradeoff.rows import Row
from calibration.folders import write_atomically
from edge.core.gel_life import DEFAULT_LIMIT_PRESSES

__all__ = ["FIRST", "METHOD_NAMES", "SHORT", "page", "table", "view_name", "write_page"]

FIRST: Final = "aupro_fpr01"
"""The measure by which the front is decided."""

METHOD_NAMES: Final = {
    "padim": "PaDiM",
    "spade": "SPADE",
    "fapm": "FAPM",
    "inreach": "InReaCh",
    "patchcore": "PatchCore",
    "subspace": "PCA subspace",
    "anomalib_padim": "anomalib's PaDiM",
    "anomalib_patchcore": "anomalib's PatchCore",
}

SHORT: Final = {
    "aupro_fpr01": "AU-PRO",
    "pixel_auprc": "AUPRC",
    "image_auroc": "AUROC",
    "recall_fpr01": "recall",
}


def view_name(name: str) -> str:
    """A view for people, such as `224x224` or `896x672 in tiles, overlap 56`."""
    if name not in VIEWS:
        return name
    view = VIEWS[name]
    size = f"{view.region.width}x{view.region.height}"
    return size if view.overlap is None else f"{size} in tiles, overlap {view.overlap}"


def page(rows: Sequence[Row]) -> str:
    """The HTML, about 300 kB for 90 points."""
    folder = resources.files("calibration.experiments.tradeoff")
    text = folder.joinpath("page.html").read_text(encoding="utf-8")
    data = json.dumps(_data(rows), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    for mark, part in (
        ("/*STYLE*/", folder.joinpath("page.css").read_text(encoding="utf-8")),
        ("/*SCRIPT*/", folder.joinpath("page.js").read_text(encoding="utf-8")),
        ("/*DATA*/", data),
    ):
        text = text.replace(mark, part)
    return text


def write_page(rows: Sequence[Row], output: Path) -> Path:
    """Write `tradeoff.html` into a folder."""
    write_atomically(output / "tradeoff.html", page(rows).encode())
    return output / "tradeoff.html"


def _data(rows: Sequence[Row]) -> dict[str, Any]:
    first = rows[0]
    scored = first["scored"]
    return {
        "subtitle": (
            f"{first['part']}/{first['position']}: {len(rows)} operating points scored on {scored['good']} good and "
            f"{scored['defective']} defective presses of pieces that no fit has seen, timed in {first['rounds']} "
            f"interleaved rounds on {first['machine']['processor']}, {first['machine']['threads']} threads. "
            f"{busy(first['machine'])}"
        ),
        "first": FIRST,
        "measures": dict(MEASURES),
        "short": SHORT,
        "names": METHOD_NAMES,
        "views": {row["view"]: view_name(row["view"]) for row in rows},
        "stages": list(WAITED),
        "margin": MARGIN,
        "digits": DIGITS,
        "gel_presses": DEFAULT_LIMIT_PRESSES,
        "points": [_point(row) for row in rows],
        "notes": list(_notes(first)),
    }


def _point(row: Row) -> dict[str, Any]:
    kept = (
        "key", "method", "mode", "backbone", "view", "settings", "presses", "gel_share", "bank_bytes",
        "bank_bytes_unpacked", "peak_memory_bytes", "content_sha256", "command", "note",
    )  # fmt: skip
    return {name: row[name] for name in kept} | {
        "accuracy": {name: _three(one, "value") for name, one in row["accuracy"].items()},
        "ms": _round(verdict_ms(row)),
        "stages": [_round(row["stages"][stage]["median"]) for stage in WAITED],
        "floor_ms": _round(row["floor"]["ms"]),
        "binds": row["floor"]["binds"],
        "fit_s": [_round(row["fit_s"]["features"]), _round(row["fit_s"]["bank"])],
        "is_int8": row["work"]["int8"] > 0,
    }  # fmt: skip


def _three(one: Row, middle: str) -> list[float | None]:
    return [_round(one[part]) for part in (middle, "low", "high")]


def _round(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def _notes(first: Row) -> Sequence[str]:
    machine, peak = first["machine"], first["peak"]
    libraries = ", ".join(f"{name} {version}" for name, version in machine["libraries"].items())
    return (
        "Accuracy: bars are 95 % intervals bootstrapped by piece, all presses of a piece together. Maps of every "
        "resolution are compared in the pixels of the low one. Recall counts the defective presses above the lowest "
        "threshold with at most 1 % false alarms.",
        "Time: milliseconds from the settled frame to the verdict, the sum of the medians of decoding, trunk and head, "
        "measured in rounds in which every point scores one press. The picture of the press leaves after the verdict.",
        "Front: a point is dominated by one that is as accurate and faster, or more accurate and at most "
        f"{100 * MARGIN:g} % slower. Accuracies that are equal in {DIGITS} digits are equal.",
        "Floor: the point's convolutions and matrix products at the fastest rate that this machine showed, or the "
        "bytes that must move once at its fastest copy, whichever takes longer. Decoding is not in it.",
        f"Gel: {DEFAULT_LIMIT_PRESSES} presses are one gel, the maker's figure.",
        f"Machine: {machine['processor']}, {machine['cores']} cores, {machine['threads']} threads, governor "
        f"{machine['governor']}, {machine['system']}, Python {machine['python']}, {libraries}; load at the start "
        f"{machine['load_at_start']:g}. Peak seen: {peak['float32_per_s'] / 1e9:.0f} GFLOP/s in float32, "
        f"{peak['int8_per_s'] / 1e9:.0f} Gop/s in int8, {peak['bytes_per_s'] / 1e9:.1f} GB/s copied.",
        f"Processor flags: {' '.join(machine['flags']) or 'not shown'}.",
        f"Presses: SHA-256 {first['dataset_sha256']}, seed {first['seed']}.",
    )


def table(rows: Sequence[Row]) -> str:
    """Write the points of the front, the fastest first."""
    heading = ["on the front", "AU-PRO", "interval", "ms to the verdict", *WAITED, "floor", "bank MB"]
    return markdown_table(heading, map(_list_costs, list_front(rows, FIRST))).rstrip()


def _list_costs(row: Row) -> list[str]:
    accuracy = row["accuracy"][FIRST]
    interval = "-" if accuracy["low"] is None else f"{accuracy['low']:.3f} to {accuracy['high']:.3f}"
    stages = (row["stages"][name]["median"] for name in WAITED)
    times = [f"{ms:.1f}" for ms in (verdict_ms(row), *stages, row["floor"]["ms"])]
    return [row["key"], f"{accuracy['value']:.3f}", interval, *times, f"{row['bank_bytes'] / 1e6:.2f}"]
