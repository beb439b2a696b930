"""One row for each kind of press: what a complete fit from pictures sees, and what it reports of that.

`python tests/bench/default_fits.py ROWS.jsonl [KIND...] --tactile FOLDER` prints the table, worst first. A row is kept
as soon as it is measured, and is not measured again; another trunk, method or free gel is another row. Kinds are those
for development, or with --judgement those for judgement: of the sensors that `SENSORS` keeps for it, and random parts
of other seeds. A kind takes about a minute of one core. --pictures FOLDER draws ten presses of each, the misses first;
--gains fits again without each mechanism that a complete fit uses, and with each alone.

peak: the share of damaged presses whose map is highest within 6 pixels of the damage; reported: that fail; of peak:
of the former, those that fail; alarms: sound held-out presses that fail; lost: presses without a pose, sound and
damaged, which are rejected. found: what `fit` says of its own rendered damage.
"""

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "support"))

from mechanisms import COMPLETE, Variant, fit_with, gains_tables, list_variants, name_parts
from numpy.typing import NDArray
from real_touch import OBJECTS, SENSORS, Object, Presses, ball, touch_trial

from calibration.experiments.backbones.sets import (
    PROFILE,
    REGION,
    Sizes,
    Trial,
    part_trial,
    random_part_trial,
)
from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.harness.rows import Rows
from calibration.fitting.damage.conditions import relight
from calibration.fitting.fit import Fitted
from calibration.fitting.options import DEFAULT_METHOD
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.trunks import DEFAULT_BACKBONE
from calibration.metrics.pixel import aupro
from calibration.metrics.summary import auroc
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.pose import HeightField, Jitter, Pose
from calibration.simulator.renderer import Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.shapes import FLOOR_MM, box, f32, plateau
from calibration.simulator.streams import Streams
from edge.core.errors import ConfigError, FitError, PoseNotFound
from edge.model.scorer import Scorer
from edge.pictures.press_picture import PressCaption, draw_press

GELS = ("right", "none", "another light")

PEAK_PX = 6
"""How far from the damage a map's peak may lie: one and a half cells of the finest tap."""
"""Which picture of the free gel a fit from pictures is given."""

# Of simulated presses that lie anywhere: those learnt and held out, how far off they lie, and how a hand presses.
_LEARNT, _HELD, _ANYWHERE_MM = 32, 17, 2.5
_BY_HAND = Jitter(0.0, 0.0, 1.0, 0.1)
_SEED = 31

Maker = Callable[[Path, str], tuple[NominalPresses, Trial]]
"""Takes the folder of real frames and a free gel; what is learnt, and what is scored."""


def _touch(chosen: Object, data: Path, gel: str) -> tuple[NominalPresses, Trial]:
    """Presses with small edits, learnt from pictures as `gelgate fit` reads them."""
    presses = chosen.read(data)
    with TemporaryDirectory() as folder:
        for number, rgb in presses.learnt.items():
            _save(Path(folder) / "learnt" / f"{number}.png", rgb)
        free = presses.free if gel == "right" else relight(presses.free, np.random.default_rng(1))
        files = [] if gel == "none" else [_save(Path(folder) / "free" / "free.png", free)]
        learnt = read_presses([Path(folder) / "learnt"], PROFILE, REGION, no_contact=files)
    return learnt, touch_trial(data, chosen)


def _save(path: Path, rgb: NDArray[np.uint8]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.ascontiguousarray(rgb[..., ::-1]))
    return path


def _part(make: Callable[[], Trial], data: Path, gel: str) -> tuple[NominalPresses, Trial]:
    """A simulated part in its fixture, or under a hand, with the simulator's damage."""
    if gel != "right":
        raise FitError("simulated parts have pictures of their free gel")
    trial = make()
    return trial.nominal, trial


def _simulate(shape: HeightField, depth_mm: float, effects: Sequence[str], data: Path) -> Presses:
    """Simulated presses of a shape that lies anywhere, at any angle."""
    streams = Streams(_SEED)
    gel = Renderer(effects=(*DEFAULT_EFFECTS, *effects), jitter=_BY_HAND, streams=streams)

    def press(number: int) -> NDArray[np.uint8]:
        away, towards, turn = streams("anywhere", number).uniform(0, (1, 2 * math.pi, 2 * math.pi)).tolist()
        away = _ANYWHERE_MM * math.sqrt(away)
        pose = Pose((away * math.cos(towards), away * math.sin(towards)), turn)
        return gel.press(shape, depth_mm, (number,), pose)

    with reproducible_opencv():
        learnt, held = (
            {str(k): press(k) for k in range(*span)} for span in ((0, _LEARNT), (_LEARNT, _LEARNT + _HELD))
        )
        return Presses(learnt, held, gel.free_gel(), has_dots="markers" in effects)


def _edge(x_mm: NDArray[np.float32], y_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    """A long plate 4 mm wide, of which one end may lie in the view."""
    return plateau(box(x_mm - 5.0, y_mm, 9.0, 2.0, 0.3), 0.0, FLOOR_MM, 0.2)


def _ball(x_mm: NDArray[np.float32], y_mm: NDArray[np.float32]) -> NDArray[np.float32]:
    radius = np.float32(4.0)
    height = np.sqrt(np.maximum(radius * radius - x_mm * x_mm - y_mm * y_mm, 0)) - radius
    return f32(np.where(height > -radius, height, FLOOR_MM))


_SAME_SENSOR = "rpl-cmu__gelslam", ("9.500mm", "*/gelsight.png", "../background.png")


def _real(of: str) -> list[Object]:
    """The objects of a set of real touch as they lie, for `fit` brings them to one pose itself."""
    return [chosen for chosen in OBJECTS if chosen.sensor in SENSORS[of] and not chosen.is_registered]


DEVELOPMENT: Mapping[str, Maker] = {
    **{
        chosen.name: partial(_touch, chosen)
        for chosen in (
            *_real("real-touch"),
            ball("ball 9.50 mm", *_SAME_SENSOR)[1],
            Object("simulated edge, anywhere", "", partial(_simulate, _edge, 0.35, ())),
            Object("simulated ball with dots, anywhere", "", partial(_simulate, _ball, 0.4, ("markers",))),
        )
    },
    **{f"simulated {part}": partial(_part, partial(part_trial, part)) for part in ("PZ1", "PZ4")},
    **{
        f"simulated random part {number}": partial(_part, partial(random_part_trial, number))
        for number in (1, 3)
    },
    "simulated PZ4, two pieces": partial(
        _part, partial(part_trial, "PZ4", sizes=Sizes(pieces=6, held_out=4, presses=12))
    ),
}
"""The kinds by which settings are chosen, by name."""

# Of the judgement parts: seeds that nothing else uses, 40 nominal presses, 20 sound and 20 damaged ones.
_JUDGEMENT_SEEDS, _JUDGEMENT_SIZES = (60_281, 60_282), Sizes(pieces=15, held_out=5, presses=4, damaged=20)

JUDGEMENT: Mapping[str, Maker] = {
    **{chosen.name: partial(_touch, chosen) for chosen in _real("real-touch-judgement")},
    **{
        f"simulated judgement part {number}": partial(
            _part, partial(random_part_trial, number, _JUDGEMENT_SIZES, seeds=_JUDGEMENT_SEEDS)
        )
        for number in range(10)
    },
}
"""The kinds that are opened once, after every choice."""


@dataclass(frozen=True, eq=False)
class Scores:
    """What a gateway makes of n presses. maps: (n, h, w), 0 without a pose; scores: (n,), without a pose twice the
    highest one; is_lost, fails, is_peak: bool (n,), rejected for want of a pose, above the threshold, and highest
    within 6 pixels of the damage."""

    maps: NDArray[np.float32]
    scores: NDArray[np.float64]
    is_lost: NDArray[np.bool_]
    fails: NDArray[np.bool_]
    is_peak: NDArray[np.bool_]


def is_on_damage(one: NDArray[np.float32], mask: NDArray[np.bool_]) -> bool:
    """Tell whether the largest value of a map lies on its mask or near it; False for an empty mask."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return bool(away[np.unravel_index(one.argmax(), one.shape)] <= PEAK_PX)


def score_presses(fitted: Fitted, frames: NDArray[np.uint8], masks: NDArray[np.bool_]) -> Scores:
    """Score presses as a gateway does. frames: uint8 (n, h, w, 3). masks: (n, h, w), the damage."""
    scorer, maps, scores = Scorer(fitted.bundle()), np.zeros(masks.shape, np.float32), np.zeros(len(masks))
    is_lost = np.zeros(len(masks), np.bool_)
    for k, rgb in enumerate(frames):
        try:
            scored = scorer.score(rgb)
        except PoseNotFound:
            is_lost[k] = True
            continue
        maps[k], scores[k] = scored.score_map, scored.anomaly_score
    scores[is_lost] = 2 * scores.max()
    fails = ~is_lost & (scores > fitted.manifest.threshold.value)
    is_near = np.array(list(map(is_on_damage, maps, masks)), np.bool_)
    is_peak = masks.any(axis=(1, 2)) & ~is_lost & is_near
    return Scores(maps, scores, is_lost, fails, is_peak)


def measure(fitted: Fitted, masks: NDArray[np.bool_], seen: Scores) -> dict[str, Any]:
    """Measure what presses with these masks of damage got."""
    manifest, is_damaged = fitted.manifest, masks.any(axis=(1, 2))
    limit = manifest.facts["limit"]
    return {
        "auroc": auroc(seen.scores, is_damaged),
        "aupro": aupro(list(seen.maps), list(masks)),
        "peak": float(seen.is_peak[is_damaged].mean()),
        "reported": float(seen.fails[is_damaged].mean()),
        "of_peak": float(seen.fails[seen.is_peak].mean()) if seen.is_peak.any() else 0.0,
        "alarms": int(seen.fails[~is_damaged].sum()),
        "sound": int((~is_damaged).sum()),
        "lost_sound": int(seen.is_lost[~is_damaged].sum()),
        "lost_damaged": int(seen.is_lost[is_damaged].sum()),
        "trunk": manifest.backbone.id if manifest.backbone else "",
        "method": manifest.method,
        "limit": limit["kind"],
        "found": limit.get("found", {}).get(limit["kind"]),
        "is_registered": fitted.bundle().registration is not None,
        "has_dots": manifest.dots is not None,
        "has_pieces": 1 < (manifest.threshold.pieces or 0) < len(manifest.threshold.nominal_scores),
        "warnings": list(manifest.provenance.warnings),
    }


def draw_presses(
    fitted: Fitted, frames: NDArray[np.uint8], masks: NDArray[np.bool_], seen: Scores
) -> NDArray[np.uint8]:
    """Draw ten presses as a station shows them, with the damage outlined, uint8 (h, w, 3); the misses first. The kinds
    of miss take turns, each from the lowest score on (false alarms from the highest)."""
    is_damaged = masks.any(axis=(1, 2))
    outcomes = {
        "MISSED, peak elsewhere": is_damaged & ~seen.fails & ~seen.is_lost & ~seen.is_peak,
        "MISSED, peak on damage": is_damaged & ~seen.fails & seen.is_peak,
        "FALSE ALARM": ~is_damaged & seen.fails,
        "NO POSE": seen.is_lost,
        "reported, peak elsewhere": is_damaged & seen.fails & ~seen.is_peak,
        "reported": seen.fails & seen.is_peak,
        "sound, passes": ~is_damaged & ~seen.fails & ~seen.is_lost,
    }
    turns = []
    for number, (outcome, is_so) in enumerate(outcomes.items()):
        order = sorted(np.flatnonzero(is_so), key=lambda k: seen.scores[k] * (1 if is_damaged[k] else -1))
        turns += [(number >= _MISSES, turn, number, k, outcome) for turn, k in enumerate(order)]
    drawn = [
        _draw(fitted, frames[k], masks[k], k, seen, outcome) for *_, k, outcome in sorted(turns)[:_DRAWN]
    ]
    drawn += [np.full_like(drawn[0], 255)] * (-len(drawn) % 2)
    rows = [np.concatenate(drawn[k : k + 2], axis=1) for k in range(0, len(drawn), 2)]
    return np.concatenate(rows)


_DRAWN, _MISSES, _PANEL = 10, 4, 384


def _draw(
    fitted: Fitted, rgb: NDArray[np.uint8], mask: NDArray[np.bool_], k: int, seen: Scores, outcome: str
) -> NDArray[np.uint8]:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    frame = cv2.drawContours(np.ascontiguousarray(rgb), outlines, -1, (255, 255, 255), 1)
    verdict = "rejected" if seen.is_lost[k] else "fail" if seen.fails[k] else "pass"
    score, threshold = float(seen.scores[k]), fitted.manifest.threshold.value
    caption = PressCaption(f"press {k}", verdict, score, threshold, PROFILE.mm_per_pixel, "", outcome, "")
    return draw_press(frame, seen.maps[k], caption, _PANEL)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table, worst first, and their mean."""

    def cells(row: Mapping[str, Any]) -> list[str]:
        how = f"{row['limit']}{', registered' * row['is_registered']}"
        found = "-" if row["found"] is None else f"{row['found']:.2f}"
        alarms = f"{row['alarms']} of {row['sound']}"
        return [row["kind"], how, *_values(row), alarms, f"{row['lost_sound']}, {row['lost_damaged']}", found]

    fitted = sorted((row for row in rows if "error" not in row), key=lambda row: row["of_peak"])
    lines = [cells(row) for row in fitted]
    if fitted:
        mean = {name: float(np.mean([row[name] for row in fitted])) for name in _MEANS}
        alarms, sound = (sum(row[name] for row in fitted) for name in ("alarms", "sound"))
        lines.append(["mean", "", *_values(mean), f"{alarms} of {sound}", "", ""])
    lines += [[row["kind"], row["error"], *[""] * 8] for row in rows if "error" in row]
    head = ["kind", "limit", "AUROC", "AU-PRO", "peak", "reported", "of peak", "alarms", "lost", "found"]
    return markdown_table(head, lines)


_MEANS = ("auroc", "aupro", "peak", "reported", "of_peak")


def _values(row: Mapping[str, Any]) -> list[str]:
    return [f"{row[name]:.3f}" for name in _MEANS]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rows", type=Path, help="the file of rows, made or continued")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="words in a kind's name; default: all kinds")
    parser.add_argument(
        "--tactile", type=Path, help="the folder of real frames; without it real kinds have an error"
    )
    parser.add_argument("--method", default=DEFAULT_METHOD)
    parser.add_argument("--backbone", default=DEFAULT_BACKBONE)
    parser.add_argument("--gel", choices=GELS, default="right", help="the picture of the free gel")
    parser.add_argument(
        "--judgement",
        action="store_true",
        help="the judgement kinds: once, after every choice, in a file of their own",
    )
    parser.add_argument("--pictures", type=Path, help="the folder for ten presses of each kind, misses first")
    parser.add_argument(
        "--gains",
        action="store_true",
        help="also fit without each mechanism that is used, and with each alone",
    )
    given = parser.parse_intermixed_args()  # kinds may follow options
    rows, how = Rows(given.rows), {"asked": [given.method, given.backbone], "gel": given.gel}
    for kind, make in (JUDGEMENT if given.judgement else DEVELOPMENT).items():
        if not any(word in kind for word in given.kinds or [""]):
            continue
        _measure_kind(
            given, rows, how, kind, cache(partial(make, given.tactile or Path("no-folder"), given.gel))
        )
    own = [row for row in rows.read() if {name: row[name] for name in how} == how]
    print(table([row for row in own if not row.get("without") and "alone" not in row]))
    if given.gains:
        print(gains_tables(own))


def _measure_kind(
    given: argparse.Namespace,
    rows: Rows,
    how: Mapping[str, Any],
    kind: str,
    make: Callable[[], tuple[NominalPresses, Trial]],
) -> None:
    """Measure the complete fit of a kind, and its variants where they are asked for, but for rows that are kept."""

    def measure_variant(variant: Variant) -> dict[str, Any]:
        key = "/".join(
            (kind, *how["asked"], given.gel, *([] if variant == COMPLETE else [" ".join(variant)]))
        )
        if key not in rows.done():
            found = _fit_and_measure(given, kind, make, variant)
            rows.append({"key": key, "kind": kind, variant[0]: variant[1], **how, **found})
            print(*variant, table([rows.read()[-1]]).splitlines()[2], flush=True)
        return next(row for row in rows.read() if row["key"] == key)

    whole = measure_variant(COMPLETE)
    if given.gains and "error" not in whole:
        for variant in list_variants(whole):
            measure_variant(variant)


def _fit_and_measure(
    given: argparse.Namespace,
    kind: str,
    make: Callable[[], tuple[NominalPresses, Trial]],
    variant: Variant,
) -> dict[str, Any]:
    """Measure a fit, and draw it where that is asked for; the sentence of a fit that is refused."""
    try:
        presses, trial = make()
        fitted = fit_with(name_parts(variant), presses, given.method, given.backbone)
    except (FitError, ConfigError) as error:
        return {"error": str(error)}
    frames, masks = trial.frames, trial.masks
    seen = score_presses(fitted, frames, masks)
    if given.pictures:
        name = "_".join((kind, given.method, given.backbone, given.gel, *variant)).replace(" ", "_")
        _save(given.pictures / f"{name}.png", draw_presses(fitted, frames, masks, seen))
    return measure(fitted, masks, seen)


if __name__ == "__main__":
    main()
