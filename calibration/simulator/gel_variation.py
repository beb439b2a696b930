"""Another gel of a sensor: the lamps and the camera stay, tint, strength of the coat and stiffness are its own."""

from dataclasses import replace
from typing import Final

import numpy as np

from calibration.simulator.sensor_appearance import SENSORS, SensorAppearance

__all__ = ["another_gel"]

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
