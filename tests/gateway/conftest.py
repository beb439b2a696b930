"""One set of recorded presses and one bundle for all gateway tests."""

from pathlib import Path

import pytest
from station import press_recording, small_bundle


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle fitted on twelve nominal presses."""
    folder = tmp_path_factory.mktemp("bundle")
    return small_bundle(folder / "pz0", press_recording(folder / "nominal", 12, seed=1))


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three presses, the second one dented."""
    return press_recording(tmp_path_factory.mktemp("recording") / "presses", 3, dented=[1], seed=2)
