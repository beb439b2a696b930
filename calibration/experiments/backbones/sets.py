"""The evaluation sets: presses of parts, damage and sensors that training never draws, rendered in memory.

The trials are the analogues PZ1 to PZ5 and random parts, under several conditions. They use the simulator's scenes and
renderer; training has other parts, other damage and another renderer.

Every set is a list of trials that any process can make. `sets.toml` says what each set shows, and what it cannot show.
"""

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files

import numpy as np

from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.simulator import parts as analogues
from calibration.simulator.field_of_view import LR
from calibration.simulator.plan import PressPlan, dataset_plan, place_damage
from calibration.simulator.pose import HeightField, Pose, sample
from calibration.simulator.random_parts import random_part
from calibration.simulator.renderer import Exposure, Renderer
from calibration.simulator.reproducible_math import reproducible_opencv
from calibration.simulator.scene import Defects, NominalPieces, Scene, paper_scenes
from calibration.simulator.sensor_appearance import SENSORS
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, U8, Mask
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region

__all__ = [
    "FORMAT",
    "PARTS",
    "PROFILE",
    "REGION",
    "SETS",
    "EvaluationSet",
    "Trial",
    "evaluation_sets",
    "part_trial",
    "random_part_trial",
]

# Of the evaluation's file; 1 and 2 had other sets.
FORMAT = 3

PROFILE = profile("cropped_lr")
REGION = Region.centre(PROFILE.size)


@dataclass(frozen=True)
class Trial:
    """The presses that a detector learns, and those that it scores."""

    name: str
    nominal: NominalPresses
    frames: U8
    """uint8 (n, h, w, 3)."""
    masks: Mask
    """bool (n, h, w), all False for an undamaged press."""


PARTS = tuple(analogues.PARTS)
SCENE_SEED = 7001
# Seeds of the random parts on which the methods' settings were chosen: for the shapes, and for everything else.
_DEVELOPMENT_SEEDS = 99, 4242
# Press depth of random parts: that of most analogues.
DEVELOPMENT_DEPTH_MM = 0.4
# The seed paper's acquisition waits this long after each picture; the robot's return also counts as released.
RELEASED_S = 3.0
# How far that press may be shifted: a part is inspected at several positions in turn.
ELSEWHERE_MM = 3.0


@dataclass(frozen=True)
class Sizes:
    """The number of sound pieces, of held-out ones among them, of presses of each, and of damaged pieces."""

    pieces: int = 10
    held_out: int = 4
    presses: int = 4
    damaged: int = 16
    free_gels: int = 4


@dataclass(frozen=True)
class Condition:
    """The differences from a plain gel on a sensor that training varies.

    learnt_at, scored_at: earlier presses on the gel.
    """

    sensor: str = "unit_b"
    effects: tuple[str, ...] = ()
    """Effects that are added to the scene's."""
    learnt_at: int = 0
    scored_at: int = 0
    is_remembering: bool = False
    """Each press has the residual imprint of one at another place."""
    slide_mm_s: float = 0.0
    """The speed of scored presses, sideways, in any direction."""


CONDITIONS: Mapping[str, Condition] = {
    "plain": Condition(),
    # A sensor that training does not mix, and an effect that it does not draw.
    "unseen sensor": Condition(sensor="unit_c", effects=("partial_contact",)),
    # A gel is rated for 1000 presses.
    "worn gel": Condition(learnt_at=700, scored_at=900),
    "marker gel": Condition(effects=("markers",)),
    "residual imprint": Condition(effects=("residual_imprint",), is_remembering=True),
    # More than the 3 mm/s that a recorded press slides at the end of its stroke: 0.09 mm in an exposure.
    "sliding press": Condition(slide_mm_s=5.0),
}


def part_trial(part: str, condition: str = "plain", sizes: Sizes | None = None) -> Trial:
    """The analogue of that name at its first position."""
    scene = next(scene for scene in paper_scenes() if scene.part == part)
    shape = analogues.PARTS[part].positions[scene.at[0]]
    return _Rendered(shape, scene, CONDITIONS[condition], SCENE_SEED, sizes or Sizes()).trial()


def random_part_trial(
    number: int, sizes: Sizes | None = None, seeds: tuple[int, int] = _DEVELOPMENT_SEEDS
) -> Trial:
    """Press the random part with that number: odd ones lie by hand, even ones in a fixture.

    seeds: of the shapes, and of everything else.
    """
    of_shapes, of_presses = seeds
    shape = random_part(np.random.default_rng([of_shapes, number]))
    jitter = analogues.PARTS["PZ3" if number % 2 else "PZ5"].jitter
    scene = next(scene for scene in paper_scenes() if scene.part == "PZ3").model_copy(
        update={
            "part": f"RP{number}",
            "positions": ("pos1",),
            "depth_mm": DEVELOPMENT_DEPTH_MM,
            "jitter": jitter,
        }
    )
    return _Rendered(shape, scene, CONDITIONS["plain"], of_presses, sizes or Sizes()).trial()


class _Rendered:
    """One shape under one condition, as a trial."""

    def __init__(
        self, shape: HeightField, scene: Scene, condition: Condition, seed: int, sizes: Sizes
    ) -> None:
        self.shape, self.condition, self.sizes, self.seed = shape, condition, sizes, seed
        self.scene = scene.model_copy(
            update={
                "positions": scene.at[:1],
                "camera": scene.camera.model_copy(update={"modes": ("lr",), "sensor": condition.sensor}),
                "effects": (*scene.effects, *condition.effects),
                "nominal": NominalPieces(specimens=sizes.pieces, presses=sizes.presses),
                "defects": Defects(
                    kinds=scene.defects.kinds, severity=scene.defects.severity, images=sizes.damaged
                ),
            }
        )
        self.streams: Streams = Streams(seed)
        sensor = SENSORS[condition.sensor]
        self.gel = Renderer(
            LR, self.scene.effects, sensor, scene.press_jitter, self.streams, "gel1", self.scene.at[0]
        )

    def trial(self) -> Trial:
        with reproducible_opencv():
            # Every press in the order of acquisition, sound and damaged pieces mixed.
            made = {plan: self._press(plan) for plan in dataset_plan(self.scene, self.seed)}
            free = [
                self.gel.free_gel(("free", number), self.condition.learnt_at)
                for number in range(self.sizes.free_gels)
            ]
        # Damaged presses first.
        plans = sorted(made, key=lambda plan: (not plan.kind, plan.name))
        learnt = {plan.name: made[plan][0] for plan in plans if self._is_learnt(plan)}
        scored = [made[plan] for plan in plans if not self._is_learnt(plan)]
        return Trial(
            self.scene.part,
            gather_presses(learnt, PROFILE, REGION, no_contact=free),
            np.stack([REGION.crop(rgb) for rgb, _ in scored]),
            np.stack([REGION.crop(mask) for _, mask in scored]),
        )

    def _is_learnt(self, plan: PressPlan) -> bool:
        return not plan.kind and plan.specimen <= self.sizes.pieces - self.sizes.held_out

    def _press(self, plan: PressPlan) -> tuple[U8, Mask]:
        """Render a press, and where it shows damage, all False on a sound piece."""
        condition, scene = self.condition, self.scene
        piece = analogues.specimen(self.shape, self.streams("specimen", scene.part, plan.specimen))
        placed, depth = self.gel.place(Pose(), plan.key), scene.press_depth_mm
        if plan.kind:
            rng = self.streams("defect", scene.part, plan.position, plan.specimen)
            defect = place_damage(self.shape, plan.kind, plan.severity, depth, scene.mask_depth_mm, rng)
            sound, imprint = self.gel.imprints(piece, defect, depth, placed)
            mask = self.gel.mask(sound, imprint, scene.mask_depth_mm)
        else:
            imprint = self.gel.imprint(sample(piece, placed, LR), depth * placed.depth_factor)
            mask = np.zeros(imprint.shape, np.bool_)
        presses = plan.gel_presses + (condition.learnt_at if self._is_learnt(plan) else condition.scored_at)
        previous = (self._earlier_imprint(plan), RELEASED_S) if condition.is_remembering else None
        light = self.gel.light(self.gel.surface(imprint, presses, previous), presses)
        return self.gel.expose(light, plan.key, Exposure(0, plan.time_s, self._velocity(plan))), mask

    def _velocity(self, plan: PressPlan) -> tuple[float, float] | None:
        """Draw the velocity of the gel during the exposure, in mm/s; None for the scene's own motion blur."""
        if self._is_learnt(plan) or not self.condition.slide_mm_s:
            return None
        angle = float(self.streams("slide", *plan.key).uniform(0, 2 * math.pi))
        return self.condition.slide_mm_s * math.cos(angle), self.condition.slide_mm_s * math.sin(angle)

    def _earlier_imprint(self, plan: PressPlan) -> F32:
        """The imprint of a press at another place of the part; at the same place the next press would hide it."""
        rng = self.streams("elsewhere", *plan.key)
        across, down = rng.uniform(-ELSEWHERE_MM, ELSEWHERE_MM, 2).tolist()
        pose = Pose((across, down), float(rng.uniform(0, 2 * math.pi)))
        return self.gel.imprint(sample(self.shape, pose, LR), self.scene.press_depth_mm)


@dataclass(frozen=True)
class EvaluationSet:
    """Trials whose measures are averaged."""

    title: str
    text: str
    """What they show, and what they cannot show."""
    trials: tuple[Callable[[], Trial], ...]
    is_brief: bool = False
    """Only the first backbone and random weights are compared on it."""


_DESCRIPTIONS = tomllib.loads(
    files("calibration.experiments.backbones").joinpath("sets.toml").read_text(encoding="utf-8")
)

SETS = tuple(_DESCRIPTIONS)
"""The names of the sets, in the order of the tables."""

# Three parts are enough for the effects of gel and press.
_FEW = tuple(part for part in PARTS if part in ("PZ1", "PZ4", "PZ5"))


def evaluation_sets() -> dict[str, EvaluationSet]:
    """Return every set by its name in `SETS`."""
    trials: dict[str, Sequence[Callable[[], Trial]]] = {
        "random-parts": [partial(random_part_trial, number) for number in range(6)],
        "parts": [partial(part_trial, part) for part in PARTS],
        "sensor": [partial(part_trial, part, "unseen sensor") for part in PARTS],
        "worn-gel": [partial(part_trial, part, "worn gel") for part in _FEW],
        "marker-gel": [partial(part_trial, part, "marker gel") for part in _FEW],
        "residual-imprint": [partial(part_trial, part, "residual imprint") for part in _FEW],
        "sliding-press": [partial(part_trial, part, "sliding press") for part in _FEW],
    }
    return {name: EvaluationSet(**about, trials=tuple(trials[name])) for name, about in _DESCRIPTIONS.items()}
