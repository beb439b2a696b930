"""The sensor profiles that come with the product, each number with its source.

The sensor has one video mode, MJPEG 3280x2464; every other size in the literature is a crop and a resize in software.
A bundle names its profile and carries the numbers, so a later change here cannot move an old bundle's geometry.
"""

from collections.abc import Mapping
from types import MappingProxyType

from edge.core.errors import ConfigError
from edge.core.imaging.sensor_profile import SensorProfile
from edge.core.suggest import suggestion

__all__ = [
    "LR_PIXELS_PER_MM",
    "MINI_BORDER",
    "MINI_CONTROLS",
    "MINI_LR_MM_PER_PX",
    "MINI_NATIVE",
    "PROFILES",
    "profile",
]

# The one mode that the sensor offers: gelsightinc/gsrobotics issue 36, v4l2-ctl listing of 2026-05-21.
MINI_NATIVE = (3280, 2464)
# One seventh is cut from each side by the maker's 2023 SDK and by gs_sdk (rows and columns alike).
MINI_BORDER = (1 / 7, 1 / 7)
# 0.0634 mm per pixel at 320x240: the maker's README FAQ, from a picture of a ruler. The datasheet's field of view
# (18.6 x 14.3 mm) says 0.058, so expect 8 % and measure with a ball where millimetres matter.
MINI_LR_MM_PER_PX = 0.0634
LR_PIXELS_PER_MM = 1 / MINI_LR_MM_PER_PX

# What the maker once recommended (gsrobotics history, mini_set_cam_params.sh), in the control names of kernels from
# 5.18 on; the device translates for older ones. Exposure is in units of 100 us: 18 ms. Nothing sets them by default,
# which is why automatic exposure moves the level by a fifth within a session.
MINI_CONTROLS: Mapping[str, int] = MappingProxyType(
    {
        "brightness": 0,
        "contrast": 32,
        "saturation": 64,
        "hue": 0,
        "white_balance_automatic": 0,
        "white_balance_temperature": 4500,
        "gamma": 140,
        "gain": 0,
        "power_line_frequency": 0,
        "sharpness": 3,
        "backlight_compensation": 0,
        "auto_exposure": 1,
        "exposure_time_absolute": 180,
        "exposure_dynamic_framerate": 0,
    }
)


def _mini(name: str, size: tuple[int, int], decode_scale: int) -> SensorProfile:
    return SensorProfile(
        name=name,
        native=MINI_NATIVE,
        border=MINI_BORDER,
        size=size,
        decode_scale=decode_scale,
        pixels_per_mm=LR_PIXELS_PER_MM * size[0] / 320,
        controls=dict(sorted(MINI_CONTROLS.items())),
    )


PROFILES: Mapping[str, SensorProfile] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            # After a 1/4 decode the crop is 586x440: 1.8 source pixels per pixel, so area resampling still averages.
            _mini("mini_lr", (320, 240), decode_scale=4),
            # The seed paper's high resolution: the 4:3 crop squeezed to 16:9, so a circle becomes an ellipse.
            # After a 1/2 decode the crop is 1172x880: 1280 columns are interpolated, 720 rows averaged.
            _mini("mini_hr", (1280, 720), decode_scale=2),
            # The same width with the true aspect.
            _mini("mini_hr43", (1280, 960), decode_scale=2),
            # Pictures that another tool has already cropped and scaled, as public data sets keep them.
            SensorProfile("cropped_lr", (320, 240), (0.0, 0.0), (320, 240), 1, LR_PIXELS_PER_MM),
        )
    }
)


def profile(name: str) -> SensorProfile:
    """The built-in profile of that name. Errors: ConfigError with the nearest known name."""
    if name in PROFILES:
        return PROFILES[name]
    raise ConfigError(f"no sensor profile is named '{name}'; {suggestion(name, PROFILES)}")
