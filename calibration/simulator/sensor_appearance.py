"""The appearance of one sensor: the colours of its free gel, and each colour's response to a slope; and another gel.

The numbers are least-squares fits to real GelSight Mini frames (320x240, 1/7 border, RGB order), made once; the frames
are not part of the product. u and v run from -1 to 1 across the crop, right and down.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from calibration.simulator import reproducible_math
from calibration.simulator.camera import NOISE_SD
from calibration.simulator.field_of_view import Field, unit_grids
from calibration.simulator.gel import GEL, Gel
from edge.core.arrays import F32, F64

__all__ = [
    "SENSORS",
    "SensorAppearance",
    "another_gel",
    "background",
    "free_gel_powers",
    "height_response",
    "place_powers",
    "response",
]

# exp of a polynomial of degree 4 in u and v, terms u^i v^j ordered by i then j with i + j <= 4, per channel R, G, B.
# Fitted to the no-contact frames of three units; residual sd about 2, 1.3 and 2 grey levels, at most 11 at a corner.
_FREE_GELS = {
    "unit_a": """
        4.94 0.347 -1.525 -0.081 0.71 -0.148 0.099 -0.014 0.0 -1.051 -0.042 0.175 0.063 -0.062 0.147
        4.74 -0.077 -0.195 0.006 -0.008 0.017 0.003 -0.017 -0.014 -0.515 0.005 -0.003 -0.074 -0.005 0.209
        4.996 -0.229 -0.873 0.09 0.466 -0.042 -0.034 0.004 0.015 -0.59 -0.016 0.013 0.017 0.0 0.138""",
    "unit_b": """
        4.986 0.346 -1.419 -0.001 0.516 0.078 0.076 -0.073 -0.029 -1.111 -0.051 0.305 -0.018 -0.032 0.243
        4.958 -0.108 -0.18 0.02 -0.011 0.01 -0.009 0.014 -0.006 -0.361 0.027 0.04 -0.187 -0.002 0.006
        5.083 -0.415 -0.842 0.225 0.541 0.034 0.018 0.0 0.037 -0.394 0.084 0.028 -0.05 -0.064 0.016""",
    "unit_c": """
        4.99 0.461 -1.497 -0.069 0.594 -0.123 0.082 -0.028 0.01 -1.023 -0.081 0.26 0.062 -0.075 0.168
        4.724 -0.083 -0.157 0.011 -0.01 0.023 0.016 -0.016 -0.016 -0.405 0.022 -0.006 -0.088 0.004 0.143
        4.999 -0.29 -0.839 0.161 0.516 -0.069 0.058 0.035 -0.03 -0.516 -0.034 -0.008 0.027 -0.028 0.134""",
}

# Grey levels per unit of the surface normal's (nx, ny), each times (1, u, v, u^2, v^2, uv), then per nx^2, ny^2, nx ny.
# Fitted to 51 presses of a 9.47 mm ball with labelled circles, slopes up to 28 degrees: R2 0.90, 0.91, 0.81.
_RESPONSE = """
    -23 -2 1 26 20 -17 -148 -14 -51 96 120 -17 20 29 22
    117 -38 -1 -62 -54 -7 10 2 -16 -6 -12 11 12 25 -12
    15 -8 5 6 2 22 92 2 -89 -47 -72 -16 27 37 -19"""


def _table(rows: str) -> F64:
    table = np.array(rows.split(), dtype=np.float64).reshape(3, -1)
    table.setflags(write=False)
    return table


@dataclass(frozen=True, eq=False)
class SensorAppearance:
    """One sensor's colours, gel and noise."""

    name: str
    free_gel: F64
    """float64 (3, 15) or (3, 28), log of the level of the untouched gel as a polynomial of degree 4 or 6 in u and v."""
    slope_response: F64 = field(default_factory=lambda: _table(_RESPONSE))
    """float64 (3, 15), grey levels per component of the surface normal."""
    height_response: F64 | None = None
    """float64 (3, 6), grey levels per mm that the gel is raised, times (1, u, v, u^2, v^2, uv); None: not fitted, none.
    """
    gel: Gel = GEL
    """How it gives way."""
    noise_sd: tuple[float, float, float] = NOISE_SD
    """Of one frame at the mean level, in grey levels, of red, green and blue."""

    def __post_init__(self) -> None:
        if self.free_gel.shape not in ((3, 15), (3, 28)):
            raise ValueError(f"a free gel has the shape (3, 15) or (3, 28), found {self.free_gel.shape}")
        if self.slope_response.shape != (3, 15):
            raise ValueError(f"a slope response has the shape (3, 15), found {self.slope_response.shape}")
        if self.height_response is not None and self.height_response.shape != (3, 6):
            raise ValueError(f"a height response has the shape (3, 6), found {self.height_response.shape}")


SENSORS = {name: SensorAppearance(name, _table(rows)) for name, rows in _FREE_GELS.items()}


def background(appearance: SensorAppearance, over: Field) -> F32:
    """The untouched gel, float32 (3, h, w), grey levels 0 to 255."""
    degree = 4 if appearance.free_gel.shape[1] == 15 else 6
    powers = free_gel_powers(over, degree)
    return reproducible_math.exp(reproducible_math.combine(appearance.free_gel, powers))


def free_gel_powers(over: Field, degree: int) -> list[F64]:
    """u^i v^j of the columns of `free_gel`, ordered by i then j with i + j up to the degree, float64 (h, w) each."""
    u, v = (np.asarray(axis, dtype=np.float64) for axis in unit_grids(over))
    return [_power(u, i) * _power(v, j) for i in range(degree + 1) for j in range(degree + 1 - i)]


def _power(x: F64, exponent: int) -> F64:
    """x to a small whole power by products, which round equally on every processor; NumPy's power does not."""
    product = np.ones_like(x)
    for _ in range(exponent):
        product = product * x
    return product


def response(appearance: SensorAppearance, over: Field) -> F32:
    """Grey levels per nx and per ny, float32 (3, 2, h, w): the lights fall off across the gel."""
    table = appearance.slope_response[:, :12].reshape(6, 6)
    return _over_places(table, over).reshape(3, 2, *over.shape)


def height_response(appearance: SensorAppearance, over: Field) -> F32 | None:
    """Grey levels per mm that the gel is raised, float32 (3, h, w); None where it was not fitted."""
    return None if appearance.height_response is None else _over_places(appearance.height_response, over)


def place_powers(over: Field) -> list[F64]:
    """(1, u, v, u^2, v^2, uv) of the responses, float64 (h, w) each."""
    u, v = (np.asarray(axis, dtype=np.float64) for axis in unit_grids(over))
    return [np.ones_like(u), u, v, u * u, v * v, u * v]


def _over_places(table: F64, over: Field) -> F32:
    """Rows of six coefficients as planes, float32 (rows, h, w)."""
    return reproducible_math.combine(table, place_powers(over)).astype(np.float32)


# Between public frames of three units the free gel differs in colour and in how the colour runs over the gel. Part of
# that is the lamps', which stay: a gel takes up to half of the difference to another unit (assumed).
_MOST_OF_A_UNIT: Final = 0.5
# The tint of a coat alone: sd of the logarithm of each colour's level (assumed; between units it is .03 to .13).
_TINT_SD: Final = 0.04
# How strongly a coat answers a slope: sd of the logarithm, common and of each colour (assumed). Two units differ up to
# 1.7 times, lamps included; two sd of this are 1.35 times.
_COAT_SD, _COAT_COLOUR_SD = 0.15, 0.05
_MOST_COAT: Final = 0.3
# The silicone is 4.25 +- 0.20 mm thick (the maker's datasheet), 5 %; its hardness varies as much again (assumed).
_STIFFNESS_SD: Final = 0.1


def another_gel(sensor: SensorAppearance, rng: np.random.Generator) -> SensorAppearance:
    """Give the sensor another pad of its kind."""
    other = SENSORS[str(rng.choice([name for name in sorted(SENSORS) if name != sensor.name]))]
    share, tint = float(rng.uniform(0, _MOST_OF_A_UNIT)), rng.normal(0, _TINT_SD, 3)
    free_gel = (1 - share) * sensor.free_gel + share * other.free_gel
    free_gel[:, 0] += tint
    coat = float(np.clip(rng.normal(0, _COAT_SD), -_MOST_COAT, _MOST_COAT))
    strength = np.exp(coat + rng.normal(0, _COAT_COLOUR_SD, 3))
    short, long = np.exp(rng.normal(0, _STIFFNESS_SD, 2)).tolist()
    short_mm = sensor.gel.short_mm * short
    gel = replace(sensor.gel, short_mm=short_mm, long_mm=max(short_mm, sensor.gel.long_mm * long))
    return replace(
        sensor, free_gel=free_gel, slope_response=sensor.slope_response * strength[:, None], gel=gel
    )
