"""The list of presses of a scene, before anything is rendered: pieces, damage, order, gel and time.

A plan is a pure function of scene and seed. It does not depend on the number of workers, or on where a run was
interrupted and resumed.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calibration.simulator.defects import Defect, place_defect
from calibration.simulator.effects import DEFAULT_EFFECTS
from calibration.simulator.field_of_view import LR, Field
from calibration.simulator.parts import PARTS, Specimen, specimen
from calibration.simulator.pose import HeightField, Pose
from calibration.simulator.renderer import Key, Renderer
from calibration.simulator.scene import Scene, SceneRun
from calibration.simulator.streams import Streams

__all__ = ["PressPlan", "damage", "dataset_plan", "piece", "place_damage", "recording_plan"]

# A press with the robot's way there and back; the seed paper's acquisition waits 3 s after each picture.
PRESS_CYCLE_S = 8.0
# Two gels were used up over 2678 listed images.
_PRESSES_PER_GEL = 1340


@dataclass(frozen=True)
class PressPlan:
    """One press. specimen counts from 1, nominal ones first; press counts from 1 within specimen and position.

    kind, severity: of its defect; kind is empty for a sound piece. gel, gel_presses: which cartridge, and how many
    presses it has had.
    """

    part: str
    position: str
    specimen: int
    press: int
    kind: str = ""
    severity: float = 0.0
    gel: str = "gel1"
    gel_presses: int = 0
    time_s: float = 0.0
    """Seconds since power on."""

    @property
    def key(self) -> Key:
        """The words that select this press's random numbers."""
        return (self.part, self.position, self.specimen, self.press)

    @property
    def name(self) -> str:
        """The file name without its ending."""
        return f"{self.part}_{self.position}_s{self.specimen:03d}_p{self.press:02d}"


def piece(plan: PressPlan, streams: Streams) -> Specimen:
    """The sound piece that is pressed, as it is seen at that position."""
    return specimen(PARTS[plan.part].positions[plan.position], streams("specimen", plan.part, plan.specimen))


# Severe enough to be marked: the imprint changes over this many LR pixels of the coarse rendering for placement.
_LEAST_MASK_PX = 6
_TRIES = 8
_LOOK = Field((224, 224), LR.mm_per_px)


def damage(plan: PressPlan, scene: Scene, streams: Streams) -> Defect | None:
    """The defect of that piece at that position, None for a sound one; its place depends on the piece and the scene.

    Where the imprint does not show it, another spot is tried, at most 8 times. A defect of almost no severity shows
    nowhere and stays at the last spot.
    """
    if not plan.kind:
        return None
    return _damage(scene, plan.part, plan.position, plan.specimen, plan.kind, plan.severity, streams)


@lru_cache(maxsize=64)
def _damage(
    scene: Scene, part: str, position: str, number: int, kind: str, severity: float, streams: Streams
) -> Defect:
    sound, rng = PARTS[part].positions[position], streams("defect", part, position, number)
    return place_damage(sound, kind, severity, scene.press_depth_mm, scene.mask_depth_mm, rng, scene.effects)


def place_damage(
    sound: HeightField,
    kind: str,
    severity: float,
    depth_mm: float,
    mask_depth_mm: float,
    rng: np.random.Generator,
    effects: tuple[str, ...] = DEFAULT_EFFECTS,
) -> Defect:
    """Place a defect on a sound shape, where the imprint with these effects shows it, if a few tries find a spot."""
    look = Renderer(_LOOK, effects)
    for _ in range(_TRIES):
        defect = place_defect(kind, severity, sound, depth_mm, rng)
        mask = look.mask(*look.imprints(sound, defect, depth_mm, Pose()), mask_depth_mm)
        if int(mask.sum()) >= _LEAST_MASK_PX:
            break
    return defect


def dataset_plan(scene: Scene, seed: int) -> list[PressPlan]:
    """Every press of a dataset, position by position, in the order in which they would be acquired.

    Sound and damaged pieces are mixed, so wear and drift carry no information about damage. A damaged piece is pressed
    once at each position, where it carries one defect, until `defects.images` pictures exist.
    """
    if scene.nominal is None:
        raise ValueError(f"scene '{scene.name}' describes recordings, not a dataset")
    streams = Streams(seed)
    plans: list[PressPlan] = []
    for place, position in enumerate(scene.at):
        pieces = _pieces(scene, place, position)
        order = streams("order", scene.part, position).permutation(len(pieces))
        presses = [press for k in order.tolist() for press in pieces[k]]
        for since_power_on, press in enumerate(presses):
            gel, worn = divmod(len(plans), _PRESSES_PER_GEL)
            time_s = since_power_on * PRESS_CYCLE_S
            plans.append(replace(press, gel=f"gel{1 + gel}", gel_presses=worn, time_s=time_s))
    return plans


def _pieces(scene: Scene, place: int, position: str) -> list[list[PressPlan]]:
    assert scene.nominal is not None
    sound = [
        [PressPlan(scene.part, position, s + 1, p + 1) for p in range(scene.nominal.presses)]
        for s in range(scene.nominal.specimens)
    ]
    images, places = scene.defects.images, len(scene.at)
    damaged = [
        [
            PressPlan(
                scene.part,
                position,
                scene.nominal.specimens + image // places + 1,
                1,
                scene.defects.kinds[image // places % len(scene.defects.kinds)],
                _graded(scene, image // places, -(-images // places)),
            )
        ]
        for image in range(place, images, places)
    ]
    return sound + damaged


def _graded(scene: Scene, piece: int, pieces: int) -> float:
    """Severities from least to most, spread so that every kind has mild and severe ones."""
    low, high = scene.defects.severity
    golden = (piece * 0.6180339887) % 1.0
    return round(low + (high - low) * (golden if pieces > 1 else 1.0), 4)


def recording_plan(scene: Scene, run: SceneRun, seed: int, press_s: float) -> list[PressPlan]:
    """Every press of a recording. Each press is of another piece; damaged ones are spread at random, never first.

    No two runs of a scene press the same piece.
    """
    names = [other.name for other in scene.runs]
    before = sum(other.presses for other in scene.runs[: names.index(run.name)])
    rng = Streams(seed)("faulty", run.name)
    faulty = set((1 + rng.permutation(run.presses - 1)[: run.faulty]).tolist()) if run.faulty else set()
    low, high = scene.defects.severity
    plans = []
    for k in range(run.presses):
        rank = sorted(faulty).index(k) if k in faulty else -1
        share = rank / max(1, run.faulty - 1)
        plans.append(
            PressPlan(
                scene.part,
                scene.at[k % len(scene.at)],
                before + k + 1,
                1,
                scene.defects.kinds[rank % len(scene.defects.kinds)] if rank >= 0 else "",
                round(low + (high - low) * share, 4) if rank >= 0 else 0.0,
                "gel1",
                run.gel_presses + k,
                scene.motion.idle_s + k * press_s,
            )
        )
    return plans
