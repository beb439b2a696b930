"""Every error that gelgate raises, drawn as a tree; each leaf says whose fault it is and what comes next.

GelgateError
├── ConfigError        operator · fix the configuration; the gateway does not start
├── BundleError        operator · re-export or replace the bundle; the gateway does not start
│   ├── BundleCorrupt      a hash, a shape or a golden frame differs from the manifest
│   └── BundleMismatch     a sound bundle for another sensor profile, or from a newer program
├── RecordingError     operator · the folder is not a recording, or a frame in it is missing
├── DatasetError       operator · files are missing, misnamed or wrongly sized
├── DeviceError        device · counted, published, retried with back-off
│   ├── DeviceNotFound     nothing that is the configured sensor is plugged in
│   ├── DeviceBusy         another process or driver holds it
│   ├── DeviceLost         it was there and is gone: unplugged, or it stopped answering
│   ├── DeviceStalled      it is there, but no new frame arrived before the deadline (a TimeoutError)
│   ├── FrameCorrupt       one frame is broken; the next may be good
│   └── RecordingEnded     a recording was played to its end
├── SinkError          broker · the row stays in the outbox and is sent again
│   ├── SinkUnavailable    not connected, or no acknowledgement in time
│   └── SinkRejected       the broker refused this message; it is set aside and offered again later
├── StoreError         machine · disk full or database damaged; inspection halts, nothing is published as pass
├── NotScorable        press · this press has no score (NaN, saturated, empty bank); never a pass
└── FitError           operator · the nominal presses do not allow a bank (none, mixed sizes, all identical)
"""

__all__ = [
    "BundleCorrupt",
    "BundleError",
    "BundleMismatch",
    "ConfigError",
    "DatasetError",
    "DeviceBusy",
    "DeviceError",
    "DeviceLost",
    "DeviceNotFound",
    "DeviceStalled",
    "FitError",
    "FrameCorrupt",
    "GelgateError",
    "NotScorable",
    "RecordingEnded",
    "RecordingError",
    "SinkError",
    "SinkRejected",
    "SinkUnavailable",
    "StoreError",
]


class GelgateError(Exception):
    """Anything that gelgate refuses: one sentence with the thing, what was found, what was expected, what to do."""


class ConfigError(GelgateError):
    """The configuration is wrong; the message lists every fault found, not the first one."""


class BundleError(GelgateError):
    """A bundle cannot be used."""


class BundleCorrupt(BundleError):
    """The bundle's content differs from its own manifest."""


class BundleMismatch(BundleError):
    """The bundle is sound but was made for another sensor profile, region or program version."""


class RecordingError(GelgateError):
    """The folder is not a recording that this program can play."""


class DatasetError(GelgateError):
    """The dataset cannot be read; the message lists every file at fault."""


class FitError(GelgateError):
    """No bank can be fitted from these presses."""


class NotScorable(GelgateError):
    """This press has no score. It is reported as an error, never as a pass."""


class StoreError(GelgateError):
    """The gateway's database or disk refused a write."""


class DeviceError(GelgateError):
    """The sensor did not deliver."""


class DeviceNotFound(DeviceError):
    """No device with the configured identity is plugged in."""


class DeviceBusy(DeviceError):
    """Another process or a kernel driver holds the device."""


class DeviceLost(DeviceError):
    """The device was open and is gone."""


class DeviceStalled(DeviceError, TimeoutError):
    """The device is present but gave no new frame before the deadline."""


class FrameCorrupt(DeviceError):
    """One frame is broken: truncated, flagged by the device, or not a picture."""


class RecordingEnded(DeviceError):
    """The recording being played has no further frame."""


class SinkError(GelgateError):
    """A message was not acknowledged."""


class SinkUnavailable(SinkError):
    """The receiver is not there, lets us not in, or did not acknowledge in time; the message is sent again."""


class SinkRejected(SinkError):
    """The receiver is there and refused this message: permissions or size. Others may pass."""
