"""The one-page report of a comparison: a table of the stages, and both maps side by side, in one HTML file."""

import base64
import html
from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.pictures.heatmap import FULL_SCALE, paint_scores
from edge.pictures.png import encode
from export.parity import Stage

__all__ = ["page"]

MOST_SHOWN = 6
"""Frames with pictures: the page stays small enough to send."""

MOST_SIDE = 320

STYLE = """body{font-family:sans-serif;max-width:70em;margin:2em auto;color:#222}table{border-collapse:collapse}
td,th{padding:.3em .8em;border-bottom:1px solid #ccc;text-align:left}td.n{text-align:right;font-family:monospace}
.bad{color:#b00020;font-weight:bold}.good{color:#11691f}figure{display:inline-block;margin:.5em}
figcaption{font-size:.85em}"""


def page(
    title: str,
    results: Sequence[Stage],
    facts: Mapping[str, str],
    frames: NDArray[np.uint8] | None = None,
) -> str:
    """Write the report as HTML with its pictures inside. frames: uint8 (n, h, w, 3), shown next to the maps."""
    first = next((result for result in results if not result.is_equal), None)
    verdict = (
        "<p class=good>Every stage agrees.</p>"
        if first is None
        else f"<p class=bad>First difference: {html.escape(first.sentence())}.</p>"
    )
    rows = "".join(f"<tr><td>{html.escape(k)}</td><td>{html.escape(v)}</td></tr>" for k, v in facts.items())
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style><h1>{html.escape(title)}</h1>{verdict}"
        + (f"<table>{rows}</table>" if rows else "")
        + f"<h2>Stages</h2><table><tr><th>stage<th>shape<th>difference<th>allowed<th>result</tr>"
        f"{''.join(map(_row, results))}</table>"
        + "<p>A difference is the largest one, as a part of the stage's largest expected value. The order of the "
        "presses is compared by rank correlation.</p>" + "".join(_pictures(results, frames)) + "</html>\n"
    )


def _row(result: Stage) -> str:
    shape = "x".join(map(str, result.expected.shape))
    number = html.escape(result.fault) if result.fault else f"{result.difference:.3g}"
    least = "at least " if result.kind == "order" else ""
    word, style = ("equal", "good") if result.is_equal else ("differs", "bad")
    return (
        f"<tr><td>{html.escape(result.name)}<td class=n>{shape}<td class=n>{number}"
        f"<td class=n>{least}{result.allowed:g}<td class={style}>{word}</tr>"
    )


def _pictures(results: Sequence[Stage], frames: NDArray[np.uint8] | None) -> Iterator[str]:
    maps = next((stage for stage in results if stage.kind == "map"), None)
    if maps is None or maps.expected.shape != maps.found.shape or maps.expected.ndim != 3:
        return
    expected, found = (np.asarray(one, np.float32) for one in (maps.expected, maps.found))
    low = float(np.nan_to_num(expected).min())
    span = max(float(np.nan_to_num(expected).max()) - low, 1e-30)
    yield "<h2>Score maps</h2><p>Both in one scale. The difference is shown a hundred times as strong.</p>"
    for number in range(min(len(expected), MOST_SHOWN)):
        if frames is not None and number < len(frames):
            yield _figure(frames[number], f"frame {number}")
        yield _figure(_map((expected[number] - low) / span), "research model")
        yield _figure(_map((found[number] - low) / span), "bundle")
        yield _figure(_map(100 * np.abs(expected[number] - found[number]) / span), "difference x 100")
        yield "<br>"


def _map(share: NDArray[np.floating]) -> NDArray[np.uint8]:
    return paint_scores(np.asarray(np.clip(np.nan_to_num(share), 0, 1) * FULL_SCALE, np.float32))


def _figure(rgb: NDArray[np.uint8], caption: str) -> str:
    scale = min(1.0, MOST_SIDE / max(rgb.shape[:2]))
    size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA) if scale < 1 else rgb
    data = base64.b64encode(encode(np.asarray(small, np.uint8))).decode()
    return (
        f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
