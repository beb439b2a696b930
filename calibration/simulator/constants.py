"""The numbers of the sensor model that both renderers read: NumPy in `calibration.simulator`, torch in training.

A number that only one renderer uses is in that renderer's module.
"""

from edge.core.imaging.known_profiles import MINI_LR_MM_PER_PX

__all__ = [
    "COARSEST_MM",
    "COAT_SIGMA_MM",
    "CROP_MM",
    "DOT_KEEPS",
    "DOT_PITCH_MM",
    "DOT_RADIUS_MM",
    "DOT_SPREAD_MM",
    "GLOSS_DOUBLINGS",
    "GLOSS_TILT",
    "GRAIN_FREE",
    "GRAIN_SIGMA_MM",
    "LIGHTS",
    "LIGHT_RISE",
    "LONG_FINEST_MM",
    "LONG_MM",
    "LONG_SHARE",
    "NOISE_LEVEL",
    "NOISE_SD",
    "PENUMBRA_MM",
    "SHADOW_REACH_MM",
    "SHADOW_STEPS",
    "SHORT_MM",
    "SWEEPS",
]

# The gel that the maker's crop shows, (x, y): 320x240 pixels.
CROP_MM = (320 * MINI_LR_MM_PER_PX, 240 * MINI_LR_MM_PER_PX)

# Near an edge the gel first drops steeply (the tension of its coat), then rises far out (the bulk of a pad 4.25 mm
# thick): two relaxation lengths and the share of the long one. With these the slope around 51 real ball presses agrees
# within 2 grey levels from 0.7 mm inside the contact to 2.3 mm outside it (docs/simulator.md).
SHORT_MM, LONG_MM, LONG_SHARE = 0.25, 1.1, 0.55
# The coat is stiff over this length: finer detail than this never shows. About a pixel at 640x480.
COAT_SIGMA_MM = 0.035
# Below this spacing a coarser level of the pyramid adds nothing.
COARSEST_MM = 0.28
# The long membrane is smooth: it is solved down to this spacing only.
LONG_FINEST_MM = 0.06
# Sweeps from the coarsest level to the finest, the last one repeated: coarse sweeps reach far and are cheap.
SWEEPS = (48, 20, 8, 3)

# Where each light shines from, as a step in (x, y): red from the top of the picture, green from the right, blue from
# below (measured on three units: a ball is red on top, green right, blue below).
LIGHTS = ((0, -1), (1, 0), (0, 1))
# The lights are low at the gel's side: about 25 degrees above it (assumed; the maker does not publish it).
LIGHT_RISE = 0.47
# Reach of a shadow that is followed; an imprint 0.5 mm high throws 1.1 mm at this elevation.
SHADOW_REACH_MM = 1.2
SHADOW_STEPS = 8
# Height over which a shadow's edge goes from none to full: the lights are bars, not points.
PENUMBRA_MM = 0.06
# The maker's coat is nearly Lambertian; the little gloss that is seen on steep flanks is a broad lobe.
GLOSS_DOUBLINGS = 3
GLOSS_TILT = 0.55

# Sd of a single frame in grey levels at the mean level, per channel R, G, B: measured 2.1-2.4, 1.4-1.7, 2.5-3.0 on
# PNG frames of the maker's resize. Half of the variance grows with the light.
NOISE_SD = (2.2, 1.5, 2.7)
NOISE_LEVEL = 100.0
# A flake's size, and the share of the paint's grain that the free gel shows. High-pass sd outside and inside contact is
# B 2.7 to 3.2, G 1.5 to 2.3, R 2.1 to 2.8 grey levels.
GRAIN_SIGMA_MM = 0.035
GRAIN_FREE = 0.35

# A tracking gel carries 7 x 9 dots in the crop: margin 24 px and radius about 6 px at 320x240.
DOT_PITCH_MM = ((320 - 48) / 8 * MINI_LR_MM_PER_PX, (240 - 48) / 6 * MINI_LR_MM_PER_PX)
DOT_RADIUS_MM = 6 * MINI_LR_MM_PER_PX
DOT_KEEPS = 0.22
# Dots move away from a bulge by about this share of its depth (estimated from the maker's marker video).
DOT_SPREAD_MM = 0.5
