"""Build the release twice from the commit that is checked out, and keep it only where both have the same bytes.

    python .ci/release.py dist

setuptools takes the times of a source archive, owners and rights from the machine, and knows no bill of materials in a
wheel (PEP 770): both are mended here, after it.
"""

import base64
import gzip
import hashlib
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from importlib.metadata import PathDistribution
from pathlib import Path

from edge.cli.bill_of_materials import package_component, write_bill

BILL = "sboms/gelgate.cdx.json"


def main(folder: Path) -> None:
    """Write wheel and source archive into the folder. Ends with 1 where two builds differ."""
    commit, epoch = run_git("log", "-1", "--format=%H %ct").decode().split()
    os.environ["SOURCE_DATE_EPOCH"] = epoch
    builds = []
    with tempfile.TemporaryDirectory() as home:
        for name, mask in (("one", 0o022), ("the other", 0o077)):
            built = build(commit, Path(home, name), mask)
            builds.append({path.name: level(path, int(epoch)) for path in sorted(built.iterdir())})
    first_build, other = builds
    if first_build != other:
        names = [name for name in first_build if first_build[name] != other.get(name)]
        sys.exit(f"two builds of one commit differ in {', '.join(names) or 'their names'}")
    folder.mkdir(exist_ok=True)
    for name, content in first_build.items():
        (folder / name).write_bytes(content)
        print(f"{hashlib.sha256(content).hexdigest()}  {folder / name}")


def run_git(*words: str) -> bytes:
    return subprocess.run(["git", *words], check=True, capture_output=True).stdout


def build(commit: str, home: Path, mask: int) -> Path:
    """Build the commit in a folder of its own. mask: as of the shell of somebody else."""
    previous = os.umask(mask)
    try:
        home.mkdir()
        with tarfile.open(fileobj=io.BytesIO(run_git("archive", commit))) as archive:
            archive.extractall(home / "source", filter="data")
        words = ["-m", "build", "--no-isolation", "--outdir", str(home / "dist"), str(home / "source")]
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
    finally:
        os.umask(previous)
    return home / "dist"


def level(path: Path, epoch: int) -> bytes:
    """Return what is released: the wheel with its bill, the source archive without what the machine put in it."""
    return add_bill(path) if path.suffix == ".whl" else level_source(path, epoch)


def level_source(path: Path, epoch: int) -> bytes:
    """Write a .tar.gz again with one time, no owner, and rights 644 or 755."""
    output = io.BytesIO()
    with (
        tarfile.open(path) as source,
        gzip.GzipFile(filename="", mode="wb", fileobj=output, mtime=epoch) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as target,
    ):
        for member in sorted(source.getmembers(), key=lambda one: one.name):
            member.uid = member.gid = 0
            member.uname = member.gname = ""
            member.mtime, member.pax_headers = epoch, {}
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            target.addfile(member, source.extractfile(member) if member.isfile() else None)
    return output.getvalue()


def add_bill(path: Path) -> bytes:
    """Write a wheel again with a bill of what is in it, named in RECORD."""
    with zipfile.ZipFile(path) as source:
        record = next(name for name in source.namelist() if name.endswith(".dist-info/RECORD"))
        info = record.removesuffix("RECORD")
        package = PathDistribution(zipfile.Path(source, info))
        bill = write_bill(package_component(package), [], []).encode()
        digest = base64.urlsafe_b64encode(hashlib.sha256(bill).digest()).decode().rstrip("=")
        lines = source.read(record).decode().splitlines()
        lines.insert(-1, f"{info}{BILL},sha256={digest},{len(bill)}")
        output = io.BytesIO()
        with zipfile.ZipFile(output, "w", zipfile.ZIP_DEFLATED) as target:
            for member in source.infolist():
                is_program = member.external_attr >> 16 & 0o100
                member.external_attr = (0o100755 if is_program else 0o100644) << 16
                if member.filename == record:
                    target.writestr(
                        zipfile.ZipInfo(info + BILL, member.date_time), bill, zipfile.ZIP_DEFLATED
                    )
                    target.writestr(member, "\n".join([*lines, ""]))
                else:
                    target.writestr(member, source.read(member))
    return output.getvalue()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
