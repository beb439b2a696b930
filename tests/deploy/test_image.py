"""The files of `deploy/`: a sound configuration everywhere, a working image where docker or podman runs."""

import contextlib
import re
import shutil
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from scripts import load_script
from tracked_tree import copy_tracked

from edge.config import load_config

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"


LOCK = DEPLOY / "requirements.txt"
PIN = re.compile(
    r"^([a-z0-9.-]+)==(\S+)(?: ; [^\n]*)? \\\n((?:    --hash=sha256:[0-9a-f]{64}.*\n)+)", re.MULTILINE
)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


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
    subprocess.run(["make", "image", f"ENGINE={program}"], check=True, timeout=1800, cwd=ROOT)
    version = subprocess.run([program, "run", "--rm", "gelgate", "--version"], capture_output=True, text=True)
    start = subprocess.run([program, "run", "--rm", "gelgate"], capture_output=True, text=True)

    assert version.stdout.startswith("gelgate ")
    assert start.returncode == 3
    assert "gelgate.toml does not exist" in start.stderr


@pytest.mark.parametrize("base", ["python:3.11-slim", "", f"python@sha256:{'0' * 64}"])
def test_a_base_without_a_digest_is_refused(base: str) -> None:
    """By the first step of the build, which says what to do; no base is named for one that is forgotten."""
    lines = (DEPLOY / "Dockerfile").read_text(encoding="utf-8").splitlines()
    first = next(line for line in lines if line.startswith("RUN "))
    step = subprocess.run(
        ["sh", "-c", first.removeprefix("RUN ")], env={"BASE": base}, capture_output=True, text=True
    )

    assert (step.returncode == 0) == ("@sha256:" in base)
    assert ("not pinned by a digest: make image" in step.stderr) == (step.returncode == 1)
    assert lines.count("ARG BASE") == 3


def in_group(name: str) -> Iterator[str]:
    """Every package that a dependency group asks for, those of the groups in it too."""
    for line in PROJECT["dependency-groups"][name]:
        yield from [line] if isinstance(line, str) else in_group(line["include-group"])


def with_extras(lines: Iterable[str]) -> Iterator[Requirement]:
    """The packages of these lines; for an extra of gelgate what it asks for."""
    for one in map(Requirement, lines):
        if one.name == "gelgate":
            for extra in one.extras:
                yield from with_extras(PROJECT["project"]["optional-dependencies"][extra])
        else:
            yield one


@pytest.mark.parametrize(
    ("lock", "wanted"),
    [
        (LOCK, [*PROJECT["project"]["dependencies"], "gelgate[metrics,signing]"]),
        (DEPLOY / "checks.txt", [*PROJECT["project"]["dependencies"], *in_group("dev")]),
        (DEPLOY / "judges.txt", [*in_group("trust")]),
    ],
    ids=["image", "checks", "judges"],
)
def test_a_lock_names_every_package_with_a_hash_and_no_server(lock: Path, wanted: list[str]) -> None:
    """After a change of pyproject.toml, `make lock`; its hashes are those of the public index, wherever it was made."""
    text = lock.read_text(encoding="utf-8")
    pins = [(match[1], match[2]) for match in PIN.finditer(text)]

    for one in with_extras(wanted):
        versions = [version for name, version in pins if name == canonicalize_name(one.name)]
        assert versions, one
        assert all(one.specifier.contains(version) for version in versions), one
    assert len(pins) == len(re.findall(r"^[a-z]", text, re.MULTILINE))
    assert "://" not in text


@pytest.mark.plain
def test_the_steps_of_the_image_give_a_program_that_answers(tmp_path: Path) -> None:
    """Without docker: what it installs by hashes is all that the wheel needs, and the program starts."""
    run = partial(subprocess.run, check=True, timeout=1800, capture_output=True, text=True)
    run([sys.executable, "-m", "venv", tmp_path / "image"])
    pip = [tmp_path / "image/bin/python", "-m", "pip", "--disable-pip-version-check"]
    uv = [
        Path(sys.executable).parent / "uv",
        "pip",
        "install",
        "--quiet",
        "--python",
        tmp_path / "image/bin/python",
    ]
    run([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", tmp_path, copy_tracked(tmp_path / "source")])
    run([*uv, "--require-hashes", "--only-binary", ":all:", "-r", LOCK])
    run([*pip, "install", "--quiet", "--no-index", "--no-deps", *tmp_path.glob("gelgate-*.whl")])

    assert "No broken requirements" in run([*pip, "check"]).stdout
    assert run([tmp_path / "image/bin/gelgate", "--version"]).stdout.startswith("gelgate ")


@pytest.mark.parametrize(("said", "is_healthy"), [(b"WATCHDOG=1", True), (b"READY=1", False)])
def test_the_health_check_hears_a_loop_that_turns(tmp_path: Path, said: bytes, is_healthy: bool) -> None:
    """What a start says is not enough; and nothing is left that the next check would meet."""
    healthcheck = load_script("deploy/healthcheck.py")
    path, heard = tmp_path / "alive", list[bool]()
    path.touch()
    listener = threading.Thread(target=lambda: heard.append(healthcheck.hear(str(path), 1.0)))
    listener.start()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as gateway:
        while listener.is_alive():
            with contextlib.suppress(OSError):
                gateway.sendto(said, str(path))
            listener.join(0.01)

    assert heard == [is_healthy]
    assert not path.exists()
