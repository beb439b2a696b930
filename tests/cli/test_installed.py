"""What comes with an installed program: versions, completion, manual, service files."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from command_line import gelgate

from edge.cli import install_service

ROOT = Path(__file__).resolve().parents[2]
SERVICE = ROOT / "edge/service"


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_the_version_names_what_decides_a_score(option: str) -> None:
    ended = gelgate(option)

    lines = ended.out.splitlines()
    assert ended.code == 0
    assert lines[0] == f"gelgate {version('gelgate')}"
    assert lines[1].startswith(f"python {sys.version.split()[0]} ")
    assert lines[2:] == [f"{name} {version(name)}" for name in ("onnxruntime", "numpy")]


def test_ctrl_c_while_the_program_is_loaded_is_no_traceback() -> None:
    loading = """
import builtins, gelgate
def stop(name, *rest, before=builtins.__import__):
    if name == "edge.cli":
        raise KeyboardInterrupt
    return before(name, *rest)
builtins.__import__ = stop
gelgate.main()
"""
    ended = subprocess.run([sys.executable, "-c", loading], capture_output=True, text=True)

    assert (ended.returncode, ended.stderr) == (130, "gelgate: interrupted\n")


def test_the_manual_is_listed_and_printed() -> None:
    """`gelgate station docs` has every page; with a name it prints that one, or the nearest that exists."""
    listed = {line.split()[0] for line in gelgate("station", "docs").out.splitlines()}
    pages = {path.relative_to(ROOT / "docs").with_suffix("") for path in (ROOT / "docs").rglob("*.md")}

    assert {page.as_posix() for page in pages} < listed
    assert gelgate("station", "docs", "mqtt").out == (ROOT / "docs/mqtt.md").read_text(encoding="utf-8")
    odd = gelgate("station", "docs", "detector")
    assert (odd.code, "did you mean 'detectors'?" in odd.sentence()) == (3, True)


@pytest.fixture
def is_outside_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever these tests run, their program counts as one that the unit can start."""
    monkeypatch.setattr(install_service, "_HIDDEN", ())


@pytest.mark.usefixtures("is_outside_home")
def test_the_service_files_are_written_for_this_installation(tmp_path: Path) -> None:
    """The unit starts this program with that configuration; the rule is the shipped one."""
    ended = gelgate("station", "install-service", "--root", tmp_path, "--config", "/srv/station.toml")

    assert ended.code == 0, ended.err
    unit = (tmp_path / "etc/systemd/system/gelgate.service").read_text()
    assert f"ExecStart={Path(sys.executable).parent / 'gelgate'} run" in unit
    assert "/srv/station.toml" in unit
    assert "/etc/gelgate" not in unit
    assert "/opt/gelgate" not in unit
    rule = (tmp_path / "etc/udev/rules.d/60-gelgate.rules").read_bytes()
    assert rule == (SERVICE / "60-gelgate.rules").read_bytes()
    for command in ("useradd", "udevadm control --reload", "systemctl enable --now gelgate"):
        assert command in ended.out


@pytest.mark.parametrize("what", ["prefix", "base_prefix"])
@pytest.mark.parametrize("more", [[], ["--print"]])
def test_a_program_that_the_sandbox_hides_is_no_service(
    what: str, more: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With ProtectHome and PrivateTmp systemd could not start it: where to install is said, and nothing is written."""
    for name in ("prefix", "base_prefix"):
        monkeypatch.setattr(sys, name, "/opt/gelgate")
    monkeypatch.setattr(sys, what, "/home/ann/gelgate")
    ended = gelgate("station", "install-service", "--root", tmp_path, *more)

    assert (ended.code, ended.out, list(tmp_path.iterdir())) == (3, "", [])
    assert "needs /home/ann/gelgate, which its sandbox hides" in ended.sentence()
    assert "python3 -m venv /opt/gelgate" in ended.sentence()


@pytest.mark.usefixtures("is_outside_home")
def test_a_service_is_removed_and_its_data_stays(tmp_path: Path) -> None:
    """Both files go; where the data lies is said. On this system the service is stopped first."""
    gelgate("station", "install-service", "--root", tmp_path)
    assert len([path for path in tmp_path.rglob("*") if path.is_file()]) == 2
    ended = gelgate("station", "install-service", "--root", tmp_path, "--remove")

    assert (ended.code, [path for path in tmp_path.rglob("*") if path.is_file()]) == (0, [])
    assert "/var/lib/gelgate" in ended.out
    script = gelgate("station", "install-service", "--remove", "--print").out.splitlines()
    assert "systemctl disable --now gelgate" in script[2]
    assert script[3:5] == [
        "rm -fv '/etc/udev/rules.d/60-gelgate.rules'", "rm -fv '/etc/systemd/system/gelgate.service'",
    ]  # fmt: skip


@pytest.mark.usefixtures("is_outside_home")
def test_the_printed_script_does_the_same(tmp_path: Path) -> None:
    """`--print` changes nothing; its script, run by a shell, writes the files that the verb writes."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("getent", "udevadm", "systemctl"):
        (tools / name).write_text(f'#!/bin/sh\necho {name} "$@" >> {tmp_path}/called\n')
        (tools / name).chmod(0o755)
    by_script, by_verb = tmp_path / "by_script", tmp_path / "by_verb"

    script = gelgate("station", "install-service", "--print", "--root", by_script).out
    is_untouched = not by_script.exists()
    subprocess.run(["sh"], input=script, text=True, check=True, env={"PATH": f"{tools}:{os.environ['PATH']}"})
    gelgate("station", "install-service", "--root", by_verb)

    assert is_untouched
    written = {path.relative_to(by_verb): path.read_text() for path in by_verb.rglob("*") if path.is_file()}
    assert len(written) == 2
    assert written == {
        path.relative_to(by_script): path.read_text() for path in by_script.rglob("*") if path.is_file()
    }
    called = (tmp_path / "called").read_text().splitlines()
    assert called[0] == "getent passwd gelgate"
    assert called[-1] == "systemctl daemon-reload"


@pytest.mark.usefixtures("is_outside_home")
def test_files_that_cannot_be_written_are_one_sentence() -> None:
    """Without the rights or on a read-only disk: the path, the reason, and what to check."""
    ended = gelgate("station", "install-service", "--root", "/proc/no")

    assert ended.code == 1
    assert "/proc/no" in ended.sentence()
