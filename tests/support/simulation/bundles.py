"""The bundles of a run: of two parts, with the smallest detector."""

from pathlib import Path

from station import press_recording, small_bundle

from simulation.surroundings import PARTS


def both_bundles(folder: Path) -> list[Path]:
    """Fit them on the same presses."""
    nominal = press_recording(folder / "nominal", 12, seed=1)
    return [small_bundle(folder / part, nominal, part=part) for part in PARTS]
