"""The options of the simulated plugins, and of the runs."""

from pathlib import Path

from pydantic import BaseModel

SECRET = "a secret of this simulation, 32 bytes and more"
"""With which a station's own people sign."""

MESSAGES = "messages"
"""The folder of the file sink."""

MEMORY = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
"""A disk that takes no time, where there is one; what is lost with the power is known by what was synced."""


class SensorOptions(BaseModel):
    """serial: of the station's own sensor; None for the only one."""

    serial: str | None = None


class NoOptions(BaseModel):
    """Nothing is asked."""
