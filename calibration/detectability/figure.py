"""The map of a study: a90/95 in mm at each place, over the mean nominal press, one panel for each kind of damage."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.detectability.pod import Pod
from calibration.detectability.results import KindResult
from calibration.detectability.study import Place, PlaceGrid, Plan
from calibration.simulator.field_of_view import grids

__all__ = ["draw_map"]

_INK, _PALE = "#1b1f24", "#ffffff"
_PANEL_INCHES, _MARGIN_INCHES, _HEIGHT_INCHES = 4.6, 1.4, 5.9
_BAR_MM = 2.0
_OPACITY = 0.72
_RIM = "#ff2d9b"
_DARK = (0.08, 0.08, 0.1, 0.72)
# The rim is where half of the presses touch.
_RIM_SHARE = 0.5


def draw_map(planned: Plan, found: list[KindResult]) -> bytes:
    """PNG bytes. Only the contact is coloured, with one scale for all panels; the pink line is its rim."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width = _PANEL_INCHES * len(found) + _MARGIN_INCHES
    with mpl.rc_context({"font.family": "DejaVu Sans", "font.size": 9, "hatch.linewidth": 0.6}):
        figure = Figure(figsize=(width, _HEIGHT_INCHES), dpi=130, facecolor=_PALE)
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(found), squeeze=False)[0]
        right = 1 - 0.95 / width
        figure.subplots_adjust(left=0.45 / width, right=right, bottom=0.21, top=0.83, wspace=0.12)
        colours = _Colours(found)
        for axis, one in zip(axes, found, strict=True):
            _panel(axis, planned, one, colours)
        _legend(figure, axes[-1], colours)
        _heading(figure, planned)
        return _png(figure)


class _Colours:
    """One logarithmic scale from the smallest to the largest size shown."""

    def __init__(self, found: list[KindResult]) -> None:
        import matplotlib as mpl
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm

        sizes = [pod.a90_95_mm for one in found for pod in one.places.values() if pod.a90_95_mm]
        low, high = (min(sizes), max(sizes)) if sizes else (0.01, 0.4)
        norm = LogNorm(low / 1.02, high * 1.02)
        self.scale = ScalarMappable(norm, mpl.colormaps["viridis_r"])

    def of(self, size_mm: float) -> tuple[float, float, float, float]:
        r, g, b, _ = self.scale.to_rgba(np.array(size_mm))
        return float(r), float(g), float(b), _OPACITY


def _panel(axis: Any, planned: Plan, one: KindResult, colours: _Colours) -> None:
    width, height = planned.grid.field.extent_mm
    extent = (-width / 2, width / 2, height / 2, -height / 2)
    share = np.asarray(np.mean([press.contact for press in planned.presses.values()], axis=0), np.float32)
    contact = cv2.GaussianBlur(share, (0, 0), 2.0)
    axis.imshow(_mean_press(planned), extent=extent, cmap="gray", vmin=0, vmax=255, interpolation="bilinear")
    axis.imshow(_painted(planned, one, colours, contact > _RIM_SHARE), extent=extent, interpolation="nearest")
    x, y = (
        np.linspace(-side / 2, side / 2, n) for side, n in ((width, share.shape[1]), (height, share.shape[0]))
    )
    axis.contour(x, y, contact, levels=[_RIM_SHARE], colors=[_RIM], linewidths=1.3)
    for place, pod in one.places.items():
        _number(axis, _middle(planned, place, contact > _RIM_SHARE), pod)
    _cell_borders(axis, planned.grid)
    axis.set_title(f"{one.kind}: {_anywhere(one)}", fontsize=10, color=_INK)
    axis.set_xlabel("mm from the middle of the region")
    _scale_bar(axis, width, height)


def _painted(
    planned: Plan, one: KindResult, colours: _Colours, contact: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """The colours of the places where they are touched, float32 (h, w, 4)."""
    paint = np.zeros((*contact.shape, 4), np.float32)
    for place, pod in one.places.items():
        cell = planned.grid.pixels(place)
        paint[cell][contact[cell]] = _DARK if pod.a90_95_mm is None else colours.of(pod.a90_95_mm)
    return paint


def _middle(planned: Plan, place: Place, contact: NDArray[np.bool_]) -> tuple[float, float]:
    """The middle of what is touched of a place, in mm."""
    cell = planned.grid.pixels(place)
    if not contact[cell].any():
        return planned.grid.middle_mm(place)
    x, y = (float(axis[cell][contact[cell]].mean()) for axis in grids(planned.grid.field))
    return x, y


def _number(axis: Any, at_mm: tuple[float, float], pod: Pod) -> None:
    from matplotlib.patheffects import withStroke

    words = {"blind": "blind", "too few": "few"}
    text = words.get(pod.state, "?") if pod.a90_95_mm is None else _size(pod.a90_95_mm)
    halo = [withStroke(linewidth=1.8, foreground=_PALE)]
    axis.text(*at_mm, text, ha="center", va="center", fontsize=6.8, color=_INK, path_effects=halo)


def _cell_borders(axis: Any, grid: PlaceGrid) -> None:
    (rows, columns), (width, height) = grid.shape, grid.field.extent_mm
    for k in range(1, columns):
        axis.axvline(k * width / columns - width / 2, color=_PALE, alpha=0.35, linewidth=0.5)
    for k in range(1, rows):
        axis.axhline(k * height / rows - height / 2, color=_PALE, alpha=0.35, linewidth=0.5)


def _size(size_mm: float) -> str:
    return f"{size_mm:.2f}".lstrip("0") if size_mm >= 0.1 else f"{size_mm:.3f}".lstrip("0")


def _anywhere(one: KindResult) -> str:
    bound = one.anywhere.a90_95_mm
    return "a90/95 anywhere not shown" if bound is None else f"a90/95 anywhere {bound:.2g} mm"


def _scale_bar(axis: Any, width: float, height: float) -> None:
    x, y = -width / 2 + 0.4, height / 2 - 0.45
    axis.plot([x, x + _BAR_MM], [y, y], color=_PALE, linewidth=4.5, solid_capstyle="butt")
    axis.plot([x, x + _BAR_MM], [y, y], color=_INK, linewidth=2.5, solid_capstyle="butt")
    note = axis.text(
        x + _BAR_MM / 2, y - 0.25, f"{_BAR_MM:g} mm", ha="center", va="bottom", fontsize=8, color=_INK
    )
    note.set_bbox({"facecolor": _PALE, "alpha": 0.7, "pad": 1.0, "edgecolor": "none"})


def _legend(figure: Any, last: Any, colours: _Colours) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import LogLocator, ScalarFormatter

    last.apply_aspect()
    box, inches = last.get_position(), figure.get_figwidth()
    bar = figure.colorbar(
        colours.scale, cax=figure.add_axes((box.x1 + 0.12 / inches, box.y0, 0.14 / inches, box.height))
    )
    bar.set_label("a90/95, mm (found in 90 % of cases, 95 % sure)")
    bar.locator = LogLocator(subs=(1, 2, 3, 5, 7))
    bar.formatter = ScalarFormatter()
    bar.minorticks_off()
    bar.update_ticks()
    marks = [
        Line2D([], [], color=_RIM, linewidth=1.3, label="rim of the contact"),
        Patch(
            facecolor=_DARK,
            label="no size is shown \u2014 blind: none is found;  ?: beyond the largest tried;  few: too few trials",
        ),
    ]
    figure.legend(
        handles=marks, loc="lower center", ncols=2 if figure.get_figwidth() > 7 else 1, frameon=False
    )


def _heading(figure: Any, planned: Plan) -> None:
    manifest, count = planned.bundle.manifest, len(planned.presses)
    is_wide = figure.get_figwidth() > 7
    figure.suptitle(
        f"{manifest.part}/{manifest.position} by {manifest.method}: smallest damage found at each place, mm"
        + (" \u2014 " if is_wide else "\n")
        + f"{count} presses, judged by {_judged(planned)}",
        fontsize=11 if is_wide else 9,
        color=_INK,
        y=0.965,
    )


def _judged(planned: Plan) -> str:
    return {
        "presses apart": "the bundle, which has not learnt them",
        "folds": "banks fitted without them",
        "third party's graph": "the third party's graph",
    }[planned.by]


def _mean_press(planned: Plan) -> NDArray[np.float32]:
    """The presses' mean in grey, with the contrast of their relief stretched, (h, w)."""
    mean = np.mean([press.rgb for press in planned.presses.values()], axis=0, dtype=np.float64)
    grey = np.asarray(mean.mean(axis=2), np.float32)
    low, high = np.percentile(grey, (1, 99))
    return np.asarray(np.clip((grey - low) / max(float(high - low), 1.0) * 255, 0, 255), np.float32)


def _png(figure: Any) -> bytes:
    import io

    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()
