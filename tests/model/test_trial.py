"""The first run of a bundle, in a child process: bounded in time and memory, with the reason in one sentence."""

import subprocess
import sys
from pathlib import Path

import pytest
import tiny
from onnx import parser
from station import mark_tried

from edge.core.errors import BundleCorrupt
from edge.gateway import opening
from edge.model.bundle import Graphs
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.signature import Trust
from edge.model.trial import try_bundle


def detector(folder: Path, body: str) -> Path:
    """A single graph that computes `extra`, one float, from `any`, the sum of its pixels, before its score."""
    model = parser.parse_model(f"""
        < ir_version: 8, opset_import: ["" : 17] >
        heavy (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, float[n] score)
        <float zero = {{0.0}}, int64[2] square = {{6000, 6000}}, int64[3] cube = {{6000, 6000, 60}}>
        {{
            pixels = Cast <to = 1> (frames)
            plain = ReduceMean <axes = [3], keepdims = 0> (pixels)
            any = ReduceSum <keepdims = 0> (pixels)
            {body}
            nothing = Mul (extra, zero)
            score_map = Add (plain, nothing)
            score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
        }}""")
    _, files = bundle_files(tiny.tiny_facts(), Graphs(detector=model.SerializeToString()))
    return write_bundle(folder / "heavy", files)


def test_a_graph_that_computes_for_hours_is_ended(tmp_path: Path) -> None:
    """Products of large matrices, one after the other: no loop, and no end in time."""
    products = "\n".join(f"m{n + 1} = MatMul (m{n}, m{n})" for n in range(200))
    path = detector(
        tmp_path, f"m0 = Expand (any, square)\n{products}\nextra = ReduceMax <keepdims = 0> (m200)"
    )

    with pytest.raises(BundleCorrupt, match="its first run did not end within 3 s"):
        try_bundle(path, seconds=3)


def test_a_graph_that_fills_the_memory_is_refused(tmp_path: Path) -> None:
    """8.6 GB in one tensor."""
    path = detector(tmp_path, "m = Expand (any, cube)\nk = Add (m, m)\nextra = ReduceMax <keepdims = 0> (k)")

    with pytest.raises(BundleCorrupt, match=r"bundle .*heavy"):
        try_bundle(path, memory_bytes=1 << 30)


def test_a_sound_bundle_passes_and_a_damaged_one_is_refused_with_its_own_sentence(tmp_path: Path) -> None:
    """What the child finds is what the parent says."""
    path = write_bundle(tmp_path / "bolt", tiny.tiny_files()[1])
    try_bundle(path)
    (path / "head.onnx").write_bytes(b"cut")

    with pytest.raises(BundleCorrupt, match=r"head\.onnx has SHA-256"):
        try_bundle(path)


def verify_below(path: Path, megabytes: int) -> tuple[int, str]:
    """How `gelgate bundle verify` ends where no process may use more address space."""
    limited = (
        f'ulimit -v {megabytes * 1000}; exec "$0" -c "from edge.cli import main; main()" bundle verify "$1"'
    )
    done = subprocess.run(
        ["sh", "-c", limited, sys.executable, path], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stderr


def test_the_limit_of_the_caller_is_kept(tmp_path: Path) -> None:
    """6 GB are enough for a sound bundle; where they are not, the sentence says whose limit it is."""
    path = write_bundle(tmp_path / "bolt", tiny.tiny_files()[1])
    heavy = detector(tmp_path, "m = Expand (any, cube)\nextra = ReduceMax <keepdims = 0> (m)")

    assert verify_below(path, 6000) == (0, "")
    code, said = verify_below(heavy, 6000)
    assert (code, "by `ulimit -v` or LimitAS= at most 5859 MB" in said, "Traceback" in said) == (
        5,
        True,
        False,
    )


def test_a_station_tries_a_bundle_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start of the same bundle with the same program does not wait for it again; another bundle is tried."""
    tried: list[Path] = []
    monkeypatch.setattr(opening, "try_bundle", lambda path, threads: tried.append(path))
    path = write_bundle(tmp_path / "bolt", tiny.tiny_files()[1])
    other = write_bundle(tmp_path / "nut", tiny.tiny_files(part="nut")[1])
    marks = tmp_path / "gelgate.db.tried"
    for one in (path, other, path, other):
        opening.try_once(one, Trust(), 2, marks)
    assert tried == [path, other]

    (path / "manifest.json").write_bytes((path / "manifest.json").read_bytes() + b" ")
    opening.try_once(path, Trust(), 2, marks)
    assert tried == [path, other, path]
    mark_tried(tmp_path / "other.db", path)
    opening.try_once(path, Trust(), 2, tmp_path / "other.db.tried")
    assert tried == [path, other, path]
