"""`.ci/release.py` takes out of a wheel and a source archive what the machine put in, and adds a bill of materials."""

import base64
import csv
import hashlib
import io
import json
import os
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
from scripts import load_script

INFO = "small-1.0.dist-info"


@pytest.fixture(scope="module")
def release() -> ModuleType:
    return load_script(".ci/release.py")


def recorded(content: bytes) -> str:
    """A hash as RECORD writes it."""
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")


def small_wheel(path: Path, mode: int) -> Path:
    """A wheel with weights, a program and its metadata."""
    files = {
        "small/trunk.onnx": b"weights",
        "small-1.0.data/data/run.sh": b"#!/bin/sh",
        f"{INFO}/METADATA": b"Metadata-Version: 2.4\nName: small\nVersion: 1.0\nLicense-Expression: MIT\n",
    }
    rows = [f"{name},{recorded(content)},{len(content)}" for name, content in files.items()]
    with zipfile.ZipFile(path, "w") as wheel:
        for name, content in {
            **files,
            f"{INFO}/RECORD": "\n".join([*rows, f"{INFO}/RECORD,,", ""]).encode(),
        }.items():
            member = zipfile.ZipInfo(name, (2026, 1, 2, 3, 4, 6))
            member.external_attr = (mode | (0o100 if name.endswith(".sh") else 0)) << 16
            wheel.writestr(member, content)
    return path


def test_the_bill_is_in_the_wheel_and_record_is_true(
    release: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the place of PEP 770, with the hash of the weights; rights of the machine are gone, a program stays one."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    built = release.add_bill(small_wheel(tmp_path / "one.whl", 0o100600))

    assert built == release.add_bill(small_wheel(tmp_path / "two.whl", 0o100664))
    with zipfile.ZipFile(io.BytesIO(built)) as wheel:
        for name, digest, size in csv.reader(wheel.read(f"{INFO}/RECORD").decode().splitlines()):
            content = wheel.read(name)
            assert name == f"{INFO}/RECORD" or (digest, int(size)) == (recorded(content), len(content))
        bill = json.loads(wheel.read(f"{INFO}/sboms/gelgate.cdx.json"))
        modes = {one.filename: oct(one.external_attr >> 16) for one in wheel.infolist()}
    (weights,) = bill["metadata"]["component"]["components"]
    assert weights["hashes"][0]["content"] == hashlib.sha256(b"weights").hexdigest()
    assert (modes["small-1.0.data/data/run.sh"], modes["small/trunk.onnx"]) == ("0o100755", "0o100644")


def small_source(path: Path, when: int, owner: str) -> Path:
    """A source archive that somebody packed at some time."""
    with tarfile.open(path, "w:gz") as archive:
        for name in ("small-1.0/b.py", "small-1.0/a.py"):
            member = tarfile.TarInfo(name)
            member.size, member.mtime, member.uname, member.mode = 1, when, owner, 0o600
            archive.addfile(member, io.BytesIO(b"x"))
    os.utime(path, (when, when))
    return path


def test_a_source_archive_does_not_tell_who_packed_it_and_when(release: ModuleType, tmp_path: Path) -> None:
    """Equal bytes of equal files; what is in it differs: then the bytes do."""
    one = release.level_source(small_source(tmp_path / "one.tar.gz", 1_000, "ann"), 1_000_000_000)

    assert one == release.level_source(small_source(tmp_path / "two.tar.gz", 2_000, "bob"), 1_000_000_000)
    with tarfile.open(fileobj=io.BytesIO(one)) as archive:
        assert [(member.name, member.mtime, member.uname) for member in archive] == [
            ("small-1.0/a.py", 1_000_000_000, ""),
            ("small-1.0/b.py", 1_000_000_000, ""),
        ]
