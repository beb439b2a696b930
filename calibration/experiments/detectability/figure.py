"""The map of a study: a90/95 in mm at each place, over the mean nominal press, one panel for each kind of damage."""

import io
from typing import Any

import cv2
import numpy as np

from calibration.experiments.detectability.pod import Pod
from calibration.experiments.detectability.results import KindResult
from calibration.experiments.detectability.study import Place, Plan
from calibration.simulator.field_of_view import grids
from edge.core.arrays import F32, Mask

__all__ = ["draw_map"]

_INK, _PALE, _RIM = "#1b1f24", "#ffffff", "#ff2d9b"
_OPACITY = 0.72
_DARK = (0.08, 0.08, 0.1, 0.72)
# The rim is where half of the presses touch.
_RIM_SHARE = 0.5
_NO_SIZE = "no size is shown \u2014 blind: none is found;  ?: beyond the largest tried;  few: too few trials"
_JUDGED_BY = {
    "presses apart": "the bundle, which has not learnt them",
    "folds": "banks fitted without them",
    "third party's graph": "the third party's graph",
}


def draw_map(planned: Plan, found: list[KindResult]) -> bytes:
    """Draw a PNG. Only the contact is coloured, with one logarithmic scale for all panels; the pink line is its rim."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = Figure(figsize=(4.6 * len(found) + 1.4, 6), dpi=130, layout="constrained")
    axes = figure.subplots(1, len(found), squeeze=False)[0]
    sizes = [pod.a90_95_mm for rows in found for pod in rows.places.values() if pod.a90_95_mm]
    low, high = (min(sizes), max(sizes)) if sizes else (0.01, 0.4)
    scale = ScalarMappable(LogNorm(low / 1.02, high * 1.02), colormaps["viridis_r"])
    for axis, kind in zip(axes, found, strict=True):
        _draw_panel(axis, planned, kind, scale)
    bar = figure.colorbar(scale, ax=list(axes), format="%g", shrink=0.8)
    bar.ax.yaxis.set_minor_formatter("{x:g}")
    bar.set_label("a90/95, mm (found in 90 % of cases, 95 % sure)")
    marks = [Line2D([], [], color=_RIM, label="rim of the contact"), Patch(facecolor=_DARK, label=_NO_SIZE)]
    figure.legend(handles=marks, loc="outside lower center", frameon=False, fontsize=8)
    manifest = planned.bundle.manifest
    figure.suptitle(
        f"{manifest.part}/{manifest.position} by {manifest.method}: smallest damage found at each place, mm\n"
        f"{len(planned.presses)} presses, judged by {_JUDGED_BY[planned.by]}",
        fontsize=10,
    )
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _draw_panel(axis: Any, planned: Plan, one: KindResult, scale: Any) -> None:
    width, height = planned.grid.field.extent_mm
    extent = (-width / 2, width / 2, height / 2, -height / 2)
    share = np.asarray(np.mean([press.contact for press in planned.presses.values()], axis=0), np.float32)
    smooth = cv2.GaussianBlur(share, (0, 0), 2.0)
    contact = smooth > _RIM_SHARE
    paint = np.zeros((*contact.shape, 4), np.float32)
    for place, pod in one.places.items():
        cell = planned.grid.pixels(place)
        paint[cell][contact[cell]] = (
            _DARK if pod.a90_95_mm is None else scale.to_rgba(pod.a90_95_mm, alpha=_OPACITY)
        )
        x, y = _middle(planned, place, contact)
        box = {"facecolor": _PALE, "alpha": 0.5, "pad": 0.5, "edgecolor": "none"}
        axis.text(x, y, _word(pod), ha="center", va="center", fontsize=6.8, color=_INK, bbox=box)
    axis.imshow(_mean_press(planned), extent=extent, cmap="gray", vmin=0, vmax=255)
    axis.imshow(paint, extent=extent, interpolation="nearest")
    axis.contour(*grids(planned.grid.field), smooth, levels=[_RIM_SHARE], colors=[_RIM])
    bound = one.anywhere.a90_95_mm
    shown = "not shown" if bound is None else f"{bound:.2g} mm"
    axis.set_title(f"{one.kind}: a90/95 anywhere {shown}", fontsize=10, color=_INK)
    axis.set_xlabel("mm from the middle of the region")


def _word(pod: Pod) -> str:
    if pod.a90_95_mm is None:
        return {"blind": "blind", "too few": "few"}.get(pod.state, "?")
    return f"{pod.a90_95_mm:.{2 if pod.a90_95_mm >= 0.1 else 3}f}".lstrip("0")


def _middle(planned: Plan, place: Place, contact: Mask) -> tuple[float, float]:
    """The middle of what is touched of a place, in mm."""
    cell = planned.grid.pixels(place)
    if not contact[cell].any():
        return planned.grid.middle_mm(place)
    x, y = (float(axis[cell][contact[cell]].mean()) for axis in grids(planned.grid.field))
    return x, y


def _mean_press(planned: Plan) -> F32:
    """The presses' mean in grey, with the contrast of their relief stretched, (h, w)."""
    mean = np.mean([press.rgb for press in planned.presses.values()], axis=0, dtype=np.float64)
    grey = np.asarray(mean.mean(axis=2), np.float32)
    low, high = np.percentile(grey, (1, 99))
    return np.asarray(np.clip((grey - low) / max(float(high - low), 1.0) * 255, 0, 255), np.float32)
