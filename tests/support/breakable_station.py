"""A station of the smallest size, whose parts a test can break one at a time."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tiny
from station import mark_tried

from edge.core.imaging.sensor_profile import SensorProfile
from edge.model.bundle import GoldenFrame
from edge.model.bundle_writer import write_bundle

CONFIG = """\
version = 1
[device]
plugin = "{device}"
options = {{ recording = "{recording}" }}
[inspection]
bundle = "{bundle}"
threads = 1
[store]
path = "{database}"
[[sinks]]
{sink}
"""
JSONL = 'plugin = "jsonl"\noptions = { folder = "out" }'


@dataclass(frozen=True)
class Bench:
    """A folder with a recording of a 48x40 sensor, a bundle for it, and configurations as a test wants them."""

    folder: Path

    def config(
        self,
        *,
        device: str = "usb_mock",
        recording: str = "presses",
        bundle: str = "bundle",
        database: str = "gelgate.db",
        sink: str = JSONL,
        name: str = "gelgate.toml",
    ) -> Path:
        text = CONFIG.format(device=device, recording=recording, bundle=bundle, database=database, sink=sink)
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        if (self.folder / bundle).is_dir() and (self.folder / database).parent.is_dir():
            mark_tried(self.folder / database, self.folder / bundle)
        return path

    def bundle(self, name: str, size: tuple[int, int] = tiny.PROFILE.size) -> Path:
        """A bundle that scores the distance to mid grey, for a sensor of that size."""
        profile = SensorProfile("tiny", size, (0.0, 0.0), size, 1, tiny.PROFILE.pixels_per_mm)
        golden = [GoldenFrame(np.zeros((32, 32, 3), np.uint8), "black", 0.75**0.5, BLACK_PEAKS)]
        _, files = tiny.tiny_files(profile=profile, golden=golden)
        return write_bundle(self.folder / name, files)


# Every cell of a black frame is sqrt(3 * 0.5^2) from mid grey.
BLACK_PEAKS = tuple((0.75**0.5,) * 8 for _ in range(8))
