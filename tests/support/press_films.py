"""Films of presses whose depth is known at every moment, cheap enough for thousands of presses.

A few parts are rendered once at fifteen depths by the simulator; a frame is interpolated between two of them, moved
sideways, lit as the film's light is at that moment, and given sensor noise. Ramps, holds, slips, a hand's tremor and
frame rates are drawn per film. The views are those of contact detection, 160x120.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np

from edge.core.arrays import F32

RATES = (5.0, 10.0, 15.0, 18.75, 25.0, 30.0, 60.0)
KINDS = ("steady", "steady", "hand", "slip", "double")
GELS = ("clear", "clear", "marker")
LIGHTS = ("steady", "wandering", "other")
# Of the full depth of the part.
DEPTHS = (0.0, 0.02, 0.05, 0.08, 0.12, 0.17, 0.23, 0.3, 0.38, 0.47, 0.57, 0.68, 0.8, 0.92, 1.1)
VIEW_MM = 18.6 / 160
NOISE_SD = 1.3


def _ball(x: Any, y: Any) -> Any:
    """A ball of 8 mm."""
    return np.asarray(np.sqrt(np.maximum(16 - x * x - y * y, 0)) - 4, np.float32)


def _soft(x: Any, y: Any) -> Any:
    """A soft ball with a fine texture: wide, flat, and never deep."""
    bumps = 0.02 * np.sin(7.1 * x + 1.3) * np.sin(6.3 * y)
    return np.asarray(-(x * x + y * y) / 60 + bumps, np.float32)


PARTS = ("PZ1", "PZ2", "PZ3", "PZ4", "PZ5", "ball", "soft")


@cache
def series(part: str, gel: str) -> F32:
    """The views of a part pressed at `DEPTHS`: float32 (15, 120, 160, 3), RGB."""
    from calibration.simulator.effects import DEFAULT_EFFECTS
    from calibration.simulator.field_of_view import LR
    from calibration.simulator.parts import PARTS as SIMULATED
    from calibration.simulator.pose import Pose, sample
    from calibration.simulator.renderer import Renderer

    own = {"ball": (_ball, 0.5), "soft": (_soft, 0.2)}
    height, depth_mm = own[part] if part in own else _of(SIMULATED[part])
    renderer = Renderer(LR, [*DEFAULT_EFFECTS, "markers"] if gel == "marker" else DEFAULT_EFFECTS)
    over = sample(height, Pose(), renderer.field)
    views = []
    for depth in DEPTHS:
        imprint = (
            renderer.imprint(over, depth_mm * depth) if depth else np.zeros(renderer.field.shape, np.float32)
        )
        planes = renderer.light(renderer.surface(imprint, 200), 200)
        views.append(cv2.resize(planes.transpose(1, 2, 0), (160, 120), interpolation=cv2.INTER_AREA))
    return np.asarray(views, np.float32)


def _of(part: Any) -> tuple[Any, float]:
    return next(iter(part.positions.values())), part.depth_mm


@dataclass(frozen=True)
class Press:
    """Down in `ramp_s`, held, and up in `lift_s`. depth: of the part's full depth. kind: see `KINDS`."""

    onset_s: float
    ramp_s: float
    hold_s: float
    lift_s: float
    depth: float
    kind: str
    is_smooth: bool
    tremor_hz: float
    slip_s: tuple[float, float]
    slip_px: tuple[float, float]

    @property
    def end_s(self) -> float:
        return self.onset_s + self.ramp_s + self.hold_s + self.lift_s

    def depth_at(self, t: float) -> float:
        """0 to 1 of the part's full depth."""
        at = t - self.onset_s
        down, up = at / self.ramp_s, (self.end_s - t) / self.lift_s
        share = float(np.clip(min(down, up), 0, 1))
        if self.is_smooth:
            share = (1 - np.cos(np.pi * share)) / 2
        tremor = 0.04 * np.sin(2 * np.pi * self.tremor_hz * at) if self.kind == "hand" else 0.0
        return float(self.depth * share * (1 + tremor))

    def place_at(self, t: float) -> tuple[float, float]:
        """Sideways, in pixels of the view."""
        at = t - self.onset_s
        if self.kind == "hand":
            swing = 0.05 / VIEW_MM
            return swing * np.sin(2 * np.pi * self.tremor_hz * 0.8 * at), swing * np.cos(4.1 * at)
        if self.kind == "slip":
            share = float(np.clip((at - self.slip_s[0]) / self.slip_s[1], 0, 1))
            return self.slip_px[0] * share, self.slip_px[1] * share
        return 0.0, 0.0

    @property
    def peak(self) -> float:
        times = np.linspace(self.onset_s, self.end_s, 400)
        return max(self.depth_at(t) for t in times)


@dataclass(frozen=True)
class Film:
    """Presses of one part on one gel, and how they were filmed."""

    part: str
    gel: str
    fps: float
    light: str
    presses: tuple[Press, ...]
    end_s: float
    seed: int

    def depth_at(self, t: float) -> float:
        return max((press.depth_at(t) for press in self.presses), default=0.0)

    def frames(self) -> Iterator[tuple[float, F32]]:
        """Time and view, float32 (120, 160, 3), in whole levels, with the jitter of a real camera's clock."""
        rng = np.random.default_rng([self.seed, 7])
        views = series(self.part, self.gel)
        noises = grains()
        number = 0
        while (t := 0.1 + number / self.fps + float(rng.uniform(-0.1, 0.1)) / self.fps) < self.end_s:
            number += 1
            press = next((p for p in self.presses if p.onset_s <= t <= p.end_s), None)
            clean = views[0] if press is None else _pressed(views, press.depth_at(t), press.place_at(t))
            noise = noises[rng.integers(len(noises))] * np.float32(rng.choice((-1, 1)))
            yield t, np.clip(np.rint(clean * self._light_at(t) + noise), 0, 255).astype(np.float32)

    def _light_at(self, t: float) -> F32:
        """A gain a colour, and a slope across the view where the light is another one: (120, 160, 3) or (3,)."""
        rng = np.random.default_rng([self.seed, 8])
        phases, periods = rng.uniform(0, 6.3, 3), rng.uniform(20, 60, 3)
        if self.light == "steady":
            return np.ones(3, np.float32)
        wander = 1 + 0.08 * np.sin(t / 13 + phases[0]) + 0.03 * np.sin(t / periods * 6.3 + phases)
        if self.light == "wandering":
            return np.asarray(wander, np.float32)
        # Another light: it comes on within five seconds in the middle of the film, brighter on one side.
        share = float(np.clip((t - self.end_s / 2) / 5, 0, 1))
        colours = 1 + share * rng.uniform(-0.15, 0.15, 3)
        slope = share * 0.03 * np.linspace(-1, 1, 160)[None, :, None]
        return np.asarray(colours + slope, np.float32)


@cache
def grains() -> tuple[F32, ...]:
    """The noise of frames."""
    rng = np.random.default_rng(3)
    return tuple(rng.normal(0, NOISE_SD, (120, 160, 3)).astype(np.float32) for _ in range(24))


def _pressed(views: F32, depth: float, place: tuple[float, float]) -> F32:
    upper = int(np.searchsorted(DEPTHS, depth, side="right"))
    if upper == 0 or depth <= 0:
        return views[0]
    upper = min(upper, len(DEPTHS) - 1)
    low, high = DEPTHS[upper - 1], DEPTHS[upper]
    share = np.float32((depth - low) / (high - low))
    added = views[upper - 1] * (1 - share) + views[upper] * share - views[0]
    if place != (0.0, 0.0):
        moved = np.array([[1, 0, place[0]], [0, 1, place[1]]], np.float64)
        added = cv2.warpAffine(added, moved, (160, 120), flags=cv2.INTER_LINEAR)
    return views[0] + added


def random_film(seed: int, presses: int = 12) -> Film:
    """Everything drawn from the seed. The first press comes after three seconds of free gel, or 14 frames."""
    rng = np.random.default_rng([seed, 1])
    fps = float(rng.choice(RATES))
    kinds = [str(rng.choice(KINDS)) for _ in range(presses)]
    t = max(3.0, 18 / fps)
    done: list[Press] = []
    for kind in kinds:
        # Two frames of free gel must be seen between presses: a rest of three frames and a half is the least.
        t += max(0.35, 3.5 / fps) if kind == "double" else float(rng.uniform(1.0, 3.0))
        press = _press(rng, t, kind)
        done.append(press)
        t = press.end_s
    return Film(
        part=str(rng.choice(PARTS)),
        gel=str(rng.choice(GELS)),
        fps=fps,
        light=str(rng.choice(LIGHTS)),
        presses=tuple(done),
        end_s=t + 2,
        seed=seed,
    )


def _press(rng: np.random.Generator, onset_s: float, kind: str) -> Press:
    ramp_s, hold_s = float(rng.uniform(0.2, 2.0)), float(rng.uniform(0.2, 2.0))
    length_px, angle = float(rng.uniform(0.3, 1.5)) / VIEW_MM, float(rng.uniform(0, 6.3))
    return Press(
        onset_s=onset_s,
        ramp_s=ramp_s,
        hold_s=hold_s,
        lift_s=float(rng.uniform(0.1, 0.5)),
        depth=float(rng.uniform(0.5, 1.0)),
        kind=kind,
        is_smooth=bool(rng.integers(2)),
        tremor_hz=float(rng.uniform(4, 10)),
        slip_s=(ramp_s * 0.8, float(rng.uniform(0.1, 0.4))),
        slip_px=(length_px * np.cos(angle), length_px * np.sin(angle)),
    )


def free_film(seed: int, frames: int) -> Film:
    """The free gel alone, for so many frames."""
    film = random_film(seed, presses=0)
    return replace(film, end_s=0.1 + frames / film.fps)


@dataclass(frozen=True)
class Outcome:
    """What became of one press. share: depth at the chosen frame as a share of the press's largest; None: not settled.
    began: how many presses were counted during it. onset: the depth at which it was noticed."""

    film: Film
    press: Press
    began: int
    share: float | None
    onset: float | None


def judged(film: Film, tracker: Any) -> tuple[list[Outcome], int, int]:
    """Each press's outcome, how many were invented, and how many frames there were. tracker: anything with the methods
    of `ContactTracker`. Events go by their names, so that an older program can be judged by the same films."""
    times: list[float] = []
    began: list[tuple[int, float]] = []
    chosen: dict[int, int] = {}
    for t, view in film.frames():
        times.append(t)
        if not (tracker.is_due(round(t * 1e9)) or not film.presses):
            continue
        for event in tracker.feed(view, round(t * 1e9), len(times) - 1):
            if type(event).__name__ == "PressBegan":
                began.append((event.timestamp_ns, t))
            elif type(event).__name__ == "PressSettled":
                chosen[event.began_ns] = event.sequence
    outcomes = []
    for press in film.presses:
        mine = [(at_ns, t) for at_ns, t in began if press.onset_s - 0.05 <= t <= press.end_s + 0.3]
        frame = chosen.get(mine[0][0]) if mine else None
        share = None if frame is None else press.depth_at(times[frame]) / press.peak
        outcomes.append(Outcome(film, press, len(mine), share, press.depth_at(mine[0][1]) if mine else None))
    return outcomes, len(began) - sum(outcome.began for outcome in outcomes), len(times)


def table(outcomes: list[Outcome], invented: int, by: Callable[[Outcome], object]) -> list[str]:
    """Rows of Markdown, one for each kind and one for all."""
    groups: dict[object, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(by(outcome), []).append(outcome)
    rows = [_row(str(name), groups[name]) for name in sorted(groups, key=str)]
    return [*rows, _row("all", outcomes) + f" {invented} |"]


HEAD = (
    "| | presses | lost | doubled | settled | settled, held 0.5 s | median | 5 % | below .8 | noticed at | invented |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def _row(name: str, group: list[Outcome]) -> str:
    shares = np.array([one.share for one in group if one.share is not None] or [0.0])
    held = [one for one in group if one.press.hold_s >= 0.5]
    onsets = [one.onset / one.press.peak for one in group if one.onset is not None]
    return (
        f"| {name} | {len(group)} | {sum(one.began == 0 for one in group)} | {sum(one.began > 1 for one in group)} | "
        f"{np.mean([one.share is not None for one in group]):.1%} | "
        f"{np.mean([one.share is not None for one in held]) if held else 0:.1%} | {np.median(shares):.3f} | "
        f"{np.quantile(shares, 0.05):.2f} | {np.mean(shares < 0.8):.2%} | {np.median(onsets or [0]):.2f} |"
    )
