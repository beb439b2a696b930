"""The files of `deploy/`: a sound configuration everywhere, a working image where docker or podman runs."""

import shutil
import subprocess
from pathlib import Path

import pytest

from edge.config import load_config

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"


def engine() -> str | None:
    """The program that can build an image here now; a client without its daemon cannot."""
    for name in ("docker", "podman"):
        path = shutil.which(name)
        if path and subprocess.run([path, "info"], capture_output=True, timeout=60).returncode == 0:
            return path
    return None


def test_the_stations_configuration_is_sound() -> None:
    """Read as the gateway reads it; its client certificate is the name in the rules."""
    config = load_config(DEPLOY / "gelgate.toml")
    rules = (DEPLOY / "mosquitto" / "rules.acl").read_text(encoding="utf-8")
    station = config.station

    assert f"user {station.station}\n" in rules
    assert f"/{station.site}/{station.line}/{station.station}/gel/v1/result\n" in rules
    assert config.sinks[0].options["tls"]["cert"].endswith(f"certificates/{station.station}.crt")


@pytest.mark.plain
def test_the_image_is_built_and_its_program_answers() -> None:
    """It says its version, and refuses a start without a configuration in one sentence."""
    program = engine()
    if program is None:
        pytest.skip("SKIPPED, NOT TESTED: no docker or podman that can build an image runs here")
    build = [program, "build", "--quiet", "--file", DEPLOY / "Dockerfile", "--tag", "gelgate-test", ROOT]
    subprocess.run(build, check=True, timeout=1800)
    version = subprocess.run(
        [program, "run", "--rm", "gelgate-test", "--version"], capture_output=True, text=True
    )
    start = subprocess.run([program, "run", "--rm", "gelgate-test"], capture_output=True, text=True)

    assert version.stdout.startswith("gelgate ")
    assert start.returncode == 3
    assert "gelgate.toml does not exist" in start.stderr
