"""Every error that gelgate raises, as a tree; each says whose fault it is and what happens next.

GelgateError
├── ConfigError        operator · fix the configuration; the gateway does not start
├── BundleError        operator · replace the bundle; the gateway does not start
│   ├── BundleCorrupt      operator · copy the complete bundle again, or make it again
│   └── BundleMismatch     operator · use the bundle made for this sensor, or update the program
├── RecordingError     operator · name another folder, or record again
├── DatasetError       operator · repair or remove the files that are listed
├── DeviceError        device · counted, published, retried with back-off
│   ├── DeviceNotFound     operator · plug it in; a running gateway waits for it
│   ├── DeviceBusy         operator · end the process that holds it; a running gateway waits for it
│   ├── DeviceLost         device · opened again as soon as it is back
│   ├── DeviceStalled      device · opened again (it is a TimeoutError, too)
│   ├── FrameCorrupt       device · counted; the next frame may be good
│   └── RecordingEnded     none · the run ends
├── SinkError          broker · the row stays in the outbox and is sent again
│   ├── SinkUnavailable    broker · sent again when it is back
│   └── SinkRejected       broker · set aside, published as an alarm, offered again within a minute
├── StoreError         machine · free space or repair the database; inspection halts, nothing is published as pass
├── ArchiveError       operator · bring back the file or the bundle that is named; no verdict is made again without it
├── PressesMissed      machine · play the recording with pace = 0, or take load from the machine
├── NotScorable        press · published as an error with its reason, never as a pass; press again
│   └── PoseNotFound       press · the press is rejected with its reason; press again
├── FitError           operator · give other or more nominal presses
└── HeightError        operator · give another picture, region or calibration; no height is guessed
"""


class GelgateError(Exception):
    """Anything that gelgate refuses: one sentence with the thing, what was found, what was expected, what to do."""

    def __str__(self) -> str:
        """Return the sentence, which messages and rows can hold: a file's name may be no UTF-8."""
        return super().__str__().encode(errors="backslashreplace").decode()


class ConfigError(GelgateError):
    """The configuration is wrong; the message lists every fault found, not the first one."""


class BundleError(GelgateError):
    """A bundle cannot be used."""


class BundleCorrupt(BundleError):
    """The bundle's content differs from its own manifest."""


class BundleMismatch(BundleError):
    """The bundle is valid but was made for another sensor profile, region or program version."""


class RecordingError(GelgateError):
    """The folder is not a recording that this program can play."""


class DatasetError(GelgateError):
    """The dataset cannot be read; the message lists every file at fault."""


class FitError(GelgateError):
    """No bank can be fitted from these presses."""


class HeightError(GelgateError):
    """No heights can be measured in this press, or nothing can be said of a region of them."""


class NotScorable(GelgateError):
    """This press has no score. It is reported as an error, never as a pass."""


class PoseNotFound(NotScorable):
    """The part of this press was not found under the gel, or lies too far outside the inspected region."""


class PressesMissed(GelgateError):
    """A recording was played to its end, and the presses seen are not those that it holds."""


class StoreError(GelgateError):
    """The gateway's database or disk refused a write."""


class ArchiveError(GelgateError):
    """What a verdict was made from is gone or damaged, so it cannot be made again."""


class DeviceError(GelgateError):
    """The sensor did not deliver."""


class DeviceNotFound(DeviceError):
    """No device with the configured identity is plugged in."""


class DeviceBusy(DeviceError):
    """Another process or a kernel driver holds the device."""


class DeviceLost(DeviceError):
    """The device was open and has disappeared."""


class DeviceStalled(DeviceError, TimeoutError):
    """The device is present but gave no new frame before the deadline."""


class FrameCorrupt(DeviceError):
    """One frame is broken: truncated, flagged by the device, or not a picture."""


class RecordingEnded(DeviceError):
    """The recording being played has no further frame."""


class SinkError(GelgateError):
    """A message was not acknowledged."""


class SinkUnavailable(SinkError):
    """The receiver is absent, refuses the login, or did not acknowledge in time; the message is sent again."""


class SinkRejected(SinkError):
    """The receiver refused this message because of its permissions or size. It may accept others."""
