"""The renderer: a part, a pose and a depth in, a picture out, computing only the effects that the scene names.

    pose -> sample -> contact -> [deformation, dust, wear] -> surface     `imprint`, `surface`
    surface -> [illumination, shadows, specular, grain, markers] -> [vignette, lens blur] -> scene light     `light`
    light -> [motion blur, drift, noise] -> whole levels -> [JPEG] -> picture     `expose`

`light` is the expensive part and does not change while a press holds still; `expose` differs from frame to frame, and
`film` makes many frames of one light.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.simulator import camera, gel, gel_surface, optics, pose, sensor_appearance
from calibration.simulator.defects import Damaged, Defect
from calibration.simulator.effects import DEFAULT_EFFECTS, check_effects
from calibration.simulator.field_of_view import LR, Field
from calibration.simulator.pose import FIXTURE, HeightField, Jitter, Pose
from calibration.simulator.streams import Streams
from edge.core.arrays import F32, F64, U8, Mask

__all__ = ["MASK_DEPTH_MM", "Exposure", "Key", "Renderer"]

Key = tuple[str | int, ...]
"""The name of a press, such as ("PZ1", "pos2", 17, 3); it selects the press's own random numbers."""

# An imprint that differs by less over 0.2 mm changes the light by less than about 10 levels: grain and noise hide it.
MASK_DEPTH_MM = 0.02

# Sideways speed of a press that had not settled: half normal with this sd (assumed).
_UNSETTLED_MM_S = 1.2


@dataclass(frozen=True)
class Exposure:
    """One exposure of a press: frame number within it, seconds since power on, sideways speed in mm/s."""

    frame: int = 0
    time_s: float = 60.0
    velocity_mm_s: tuple[float, float] | None = None


@dataclass(eq=False)
class Renderer:
    """Renders one sensor with one gel."""

    field: Field = LR
    """The pixels."""
    effects: Iterable[str] = DEFAULT_EFFECTS
    """Their names."""
    sensor: sensor_appearance.SensorAppearance = dataclasses.field(
        default_factory=lambda: sensor_appearance.SENSORS["unit_b"]
    )
    """Its colours."""
    jitter: Jitter = FIXTURE
    """How presses differ (for `pose_jitter`)."""
    streams: Streams = dataclasses.field(default_factory=lambda: Streams(0))
    """Where random numbers come from; `gel_id` and `session` select the gel's dust and the lamps' drift. A renderer
    holds about 15 float32 pictures and nothing that grows."""
    gel_id: str = "gel1"
    session: str = "session1"
    _coat: dict[str, tuple[int, F32]] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        self.effects = check_effects(self.effects)
        self._on = self.effects

    def place(self, commanded: Pose, key: Key) -> Pose:
        """The actual pose of one press."""
        if "pose_jitter" in self._on:
            commanded = pose.pose_jitter(commanded, self.jitter, self.streams("pose_jitter", *key))
        if "partial_contact" in self._on:
            commanded = pose.partial_contact(commanded, self.streams("partial_contact", *key))
        return commanded

    def imprint(self, height: F32, depth_mm: float) -> F32:
        """The gel's surface over a part at this depth, in mm, float32 (h, w), without dust and wear.

        height: the part over the field, as `sample` gives it.
        """
        obstacle = pose.contact(height, depth_mm)
        if "deformation" not in self._on:
            return obstacle
        return gel.deformation(obstacle, self.field, self.sensor.gel)

    def surface(self, imprint_mm: F32, presses: int = 0, previous: tuple[F32, float] | None = None) -> F32:
        """The gel's real surface: the imprint, the residual of the previous one, grains and scratches.

        presses: how many this gel has had. previous: the previous imprint and the seconds since its release.
        """
        if "residual_imprint" in self._on and previous is not None:
            imprint_mm = gel.residual_imprint(imprint_mm, *previous)
        if "dust" in self._on:
            imprint_mm = gel_surface.dust(imprint_mm, self._dust_relief(presses))
        if "wear" in self._on:
            imprint_mm = gel_surface.wear(imprint_mm, self._wear_relief(presses))
        return imprint_mm

    def light(self, surface_mm: F32, presses: int = 0) -> F32:
        """The picture that reaches the sensor, float32 (3, h, w) in grey levels, before effects that change per
        frame."""
        nx, ny = optics.normals(surface_mm, self.field)
        is_lit = "illumination" in self._on
        planes = optics.illumination(nx, ny, *self._lamps) if is_lit else optics.headlight(nx, ny)
        if is_lit and self._per_mm is not None:
            planes = optics.raise_planes(planes, surface_mm, self._per_mm)
        if "shadows" in self._on:
            planes = optics.shadows(planes, surface_mm, self.field)
        if "specular" in self._on:
            planes = optics.specular(planes, nx, ny)
        if "grain" in self._on:
            planes = gel_surface.grain(planes, surface_mm, self._grain_texture)
        if "wear" in self._on:
            planes *= self._wear_stains(presses)
        if "markers" in self._on:
            planes = gel_surface.markers(planes, surface_mm, self.field)
        rim = camera.gel_rim(self.field)
        if rim is not None:
            planes *= rim
        if "vignette" in self._on:
            planes = camera.vignette(planes, camera.lens_falloff(self.field))
        if "lens_blur" in self._on:
            planes = camera.lens_blur(planes, self.field)
        return planes

    def expose(self, planes: F32, key: Key, exposure: Exposure) -> U8:
        """Expose a frame of that light, uint8 (h, w, 3) RGB. `planes` is not changed."""
        if "motion_blur" in self._on:
            velocity = exposure.velocity_mm_s
            if velocity is None:
                across, down = self.streams("motion_blur", *key).normal(0, _UNSETTLED_MM_S / 2**0.5, 2)
                velocity = (float(across), float(down))
            planes = camera.motion_blur(planes.copy(), velocity, self.field)
        return next(self.film(planes, (key,), exposure))

    def film(self, planes: F32, keys: Iterable[Key], exposure: Exposure) -> Iterator[U8]:
        """Expose a frame for each key, while neither the gel nor the light changes, as `expose` does."""
        planes = planes.copy()
        if "led_drift" in self._on:
            planes = camera.led_drift(planes, exposure.time_s, self.streams("led_drift", self.session))
        spread = camera.noise_spread(planes, self.sensor.noise_sd) if "noise" in self._on else None
        for key in keys:
            shown = planes
            if spread is not None:
                shown = camera.noise(planes.copy(), self.streams("noise", *key, exposure.frame), spread)
            rgb = camera.quantise(shown)
            yield camera.jpeg(rgb) if "jpeg" in self._on else rgb

    def press(
        self,
        part: HeightField,
        depth_mm: float,
        key: Key = (),
        commanded: Pose | None = None,
        presses: int = 0,
        exposure: Exposure | None = None,
    ) -> U8:
        """Draw a settled press, uint8 (h, w, 3) RGB: all steps in one call."""
        placed = self.place(commanded or Pose(), key)
        imprint = self.imprint(pose.sample(part, placed, self.field), depth_mm * placed.depth_factor)
        return self._picture(imprint, key, presses, exposure)

    def damage(
        self,
        part: HeightField,
        defect: Defect,
        depth_mm: float,
        key: Key = (),
        commanded: Pose | None = None,
        presses: int = 0,
        exposure: Exposure | None = None,
        mask_depth_mm: float = MASK_DEPTH_MM,
    ) -> tuple[U8, Mask]:
        """Draw a press on the damaged part: (rgb, mask).

        mask: bool (h, w), where its imprint differs from the sound part's by more than `mask_depth_mm`. A press on the
        sound part with the same key shares pose, gel and noise, so only the defect differs.
        """
        sound, damaged = self.imprints(part, defect, depth_mm, self.place(commanded or Pose(), key))
        return self._picture(damaged, key, presses, exposure), self.mask(sound, damaged, mask_depth_mm)

    def imprints(self, part: HeightField, defect: Defect, depth_mm: float, placed: Pose) -> tuple[F32, F32]:
        """The imprints of the sound and of the damaged part in one pose, mm, float32 (h, w) each."""
        depth = depth_mm * placed.depth_factor
        sound = self.imprint(pose.sample(part, placed, self.field), depth)
        damaged = self.imprint(pose.sample(Damaged(part, defect), placed, self.field), depth)
        return sound, damaged

    @staticmethod
    def mask(sound: F32, damaged: F32, depth_mm: float = MASK_DEPTH_MM) -> Mask:
        """True where two imprints differ by more than this many mm: the visible defect."""
        return np.asarray(np.abs(damaged - sound) > np.float32(depth_mm))

    def free_gel(self, key: Key = ("free",), presses: int = 0, exposure: Exposure | None = None) -> U8:
        """The untouched gel as a picture, uint8 (h, w, 3) RGB."""
        return self._picture(np.zeros(self.field.shape, dtype=np.float32), key, presses, exposure)

    def _picture(self, imprint: F32, key: Key, presses: int, exposure: Exposure | None) -> U8:
        return self.expose(self.light(self.surface(imprint, presses), presses), key, exposure or Exposure())

    @cached_property
    def _lamps(self) -> tuple[F32, F32, F32]:
        """Planes of the free gel before the lens, grey levels per normal, and the quadratic part."""
        seen = sensor_appearance.background(self.sensor, self.field)
        # The measured colours include the lens, which is a separate effect.
        lens = camera.lens_falloff(self.field)
        curvature = self.sensor.slope_response[:, 12:].astype(np.float32)
        return seen / lens, sensor_appearance.response(self.sensor, self.field) / lens, curvature

    @cached_property
    def _per_mm(self) -> F32 | None:
        seen = sensor_appearance.height_response(self.sensor, self.field)
        return None if seen is None else seen / camera.lens_falloff(self.field)

    @cached_property
    def _grain_texture(self) -> F32:
        return gel_surface.grain_texture(self.streams("grain", self.gel_id), self.field)

    @cached_property
    def _dust(self) -> F64:
        return gel_surface.new_dust(self.streams("dust", self.gel_id))

    @cached_property
    def _wear(self) -> tuple[F64, F64]:
        return gel_surface.new_wear(self.streams("wear", self.gel_id))

    def _dust_relief(self, presses: int) -> F32:
        number = gel_surface.marks_at(self._dust, presses)
        return self._cached("dust", number, lambda: gel_surface.dust_relief(self._dust, presses, self.field))

    def _wear_relief(self, presses: int) -> F32:
        scratches, _ = self._wear
        number = gel_surface.marks_at(scratches, presses)
        return self._cached("relief", number, lambda: gel_surface.wear_relief(scratches, presses, self.field))

    def _wear_stains(self, presses: int) -> F32:
        # Stains darken slowly: every 20 presses is often enough.
        step, (_, stains) = presses // 20, self._wear
        return self._cached("stains", step, lambda: gel_surface.wear_stains(stains, 20 * step, self.field))

    def _cached(self, what: str, state: int, make: Callable[[], F32]) -> F32:
        """A picture of the coat, made again only when its state has changed."""
        kept = self._coat.get(what)
        if kept is None or kept[0] != state:
            kept = (state, make())
            self._coat[what] = kept
        return kept[1]
