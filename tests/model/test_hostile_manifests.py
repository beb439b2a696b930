"""Manifests that nobody writes by accident: each is refused with its field, before memory or time is spent."""

import hashlib
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tiny

from edge.core.errors import BundleCorrupt
from edge.model.archive import MANIFEST, MAX_FILE_BYTES
from edge.model.bundle import Bundle, GoldenFrame
from edge.model.bundle_writer import write_bundle
from edge.model.manifest_files import MAX_BUNDLE_BYTES
from edge.model.scorer import Scorer

GOLDEN = GoldenFrame(tiny.presses(1)[0], "a press", 0.5, ((0.5,),))
CONTACT = {"x": [0.1, 0.9], "y": [0.1, 0.9], "area": [0.1, 0.9]}
COST = dict.fromkeys(("trunk_ms", "head_ms", "threads", "features_s", "fit_s", "threshold_s"), 1)
COST |= {"bank_bytes_stored": 1, "bank_bytes_unpacked": 10**400}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    _, files = tiny.tiny_files(golden=[GOLDEN])
    return write_bundle(tmp_path / "bolt", files)


def edited(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    path = folder / MANIFEST
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return folder


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m.update(threshold=None), "threshold"),
        (lambda m: m["threshold"].update(value="NaN"), "threshold.value"),
        (lambda m: m.update(surprise=1), "surprise"),
        (lambda m: m["head"].update(file="../head.onnx"), "head.file"),
        (lambda m: m["head"].update(file="/etc/passwd"), "head.file"),
        (lambda m: m["region"].update(x=400), "outside the picture"),
        (lambda m: m["grid"].update(frame=[30, 32]), "the head is built for"),
        (lambda m: m.update(head=None), "either backbone, head and grid"),
        (lambda m: m.pop("schema_version"), "not a gelgate manifest"),
        (lambda m: m["head"].update(size_bytes=2**63), "head.size_bytes"),
        (lambda m: m["head"].update(size_bytes=10**400), "head.size_bytes"),
        (lambda m: m["head"].update(size_bytes=MAX_FILE_BYTES + 1), "head.size_bytes"),
        (lambda m: m["grid"]["taps"].update(layer1=[-3, 4, 4]), "grid.taps.layer1"),
        (lambda m: m["grid"]["taps"].update(layer1=[2**64, 4, 4]), "grid.taps.layer1"),
        (lambda m: m["grid"]["taps"].update(layer1=[65536, 8192, 8192]), "the tap 'layer1'"),
        (lambda m: m["golden"][0].update(map_peaks=[[0.5], [0.5, 0.5]]), "rows of map_peaks"),
        (lambda m: m["golden"][0].update(map_peaks=[[]]), "rows of map_peaks"),
        (lambda m: m["golden"][0].update(map_peaks=[]), "map_peaks"),
        (lambda m: m["profile"].update(size=[2**31, 40]), "sizes are 1 to 8192 pixels"),
        (lambda m: m["profile"].update(pixels_per_mm=0), "a name and a scale"),
        (lambda m: m["profile"].update(name=""), "a name and a scale"),
        (lambda m: m["profile"].update(lens="wide"), "profile.lens"),
        (lambda m: m["profile"].update(border=[0.5, 0]), "fractions of the border"),
        (lambda m: m["profile"].update(decode_scale=3), "decode_scale is"),
        (lambda m: m["region"].update(width=200_000, height=200_000), "the head is built for"),
        (lambda m: m.update(contact={**CONTACT, "x": [0.9, 0.1]}), "x runs from low to high"),
        (lambda m: m.update(cost=COST), "cost.bank_bytes_unpacked"),
        (lambda m: m.update(part="\ud800"), "is not a gelgate manifest"),
        (
            lambda m: next(iter(m["bank"].values())).update(shape=[10**6, 10**5, 10**5]),
            "an array has at most",
        ),
    ],
)
def test_a_manifest_that_makes_no_sense_is_refused(
    folder: Path, change: Callable[[dict[str, Any]], object], reason: str
) -> None:
    """With the field, by `inspect`, `verify` and `run` alike."""
    with pytest.raises(BundleCorrupt, match=reason):
        Bundle.load(edited(folder, change))


def test_the_files_of_a_bundle_are_bounded_together(folder: Path) -> None:
    """Each may be large, and not all of them."""

    def grow(manifest: dict[str, Any]) -> None:
        for entry in (manifest["head"], manifest["backbone"]["trunk"], manifest["golden"][0]["image"]):
            entry["size_bytes"] = MAX_FILE_BYTES

    with pytest.raises(BundleCorrupt, match=f"at most {MAX_BUNDLE_BYTES} are read"):
        Bundle.load(edited(folder, grow))


def test_a_sparse_file_is_refused_by_its_size(folder: Path) -> None:
    """100 GB that take no room on the disk: nothing of it is read."""
    with (folder / "head.onnx").open("r+b") as file:
        file.truncate(100 << 30)

    with pytest.raises(BundleCorrupt, match=r"head\.onnx has 107374182400 bytes"):
        Bundle.load(folder)


def test_a_zip_bomb_is_read_up_to_the_size_in_the_manifest(folder: Path, tmp_path: Path) -> None:
    """Its directory may lie about the size; the manifest's, which is bounded, counts."""
    bomb = tmp_path / "bomb.zip"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and path.name != "head.onnx":
                archive.write(path, str(path.relative_to(folder)))
        archive.writestr("head.onnx", bytes(50 << 20))

    with pytest.raises(BundleCorrupt, match=r"head\.onnx has 52428800 bytes, at most"):
        Bundle.load(bomb)


_HOSTILE = {
    "(": b"(" * 9000,
    "-": b"-" * 9000,
    "[": b"[" * 60_000,
    "key": b"{b'descr': '<f4', 'fortran_order': False, 'shape': (1,)}",
    "dtype": b"{'descr': ((), ()), 'fortran_order': False, 'shape': (1,)}",
    "comma": b"{'descr': ',f4', 'fortran_order': False, 'shape': (1,)}",
    "indent": b"if 1:\n   a\n  b\n",
}


@pytest.mark.parametrize("header", _HOSTILE.values(), ids=_HOSTILE)
def test_a_header_that_is_hostile_python_is_refused(folder: Path, header: bytes) -> None:
    """numpy reads the header of an array as Python text."""
    data = b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header
    name = next(path for path in (folder / "bank").iterdir())
    name.write_bytes(data)

    def change(manifest: dict[str, Any]) -> None:
        entry = next(e["data"] for e in manifest["bank"].values() if e["data"]["file"] == f"bank/{name.name}")
        entry.update(size_bytes=len(data), sha256=hashlib.sha256(data).hexdigest())

    with pytest.raises(BundleCorrupt, match="is not a npy file"):
        Bundle.load(edited(folder, change))


def test_a_gigantic_picture_is_not_decoded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """30000 x 30000 pixels in some bytes: the size is read from the header, and is not that of the region."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    )
    (folder / "golden/0.png").write_bytes(data)

    def change(manifest: dict[str, Any]) -> None:
        manifest["golden"][0]["image"].update(size_bytes=len(data), sha256=hashlib.sha256(data).hexdigest())

    def decode(*arguments: object) -> None:
        raise AssertionError("it was decoded, which takes 2.7 GB")

    monkeypatch.setattr("cv2.imdecode", decode)
    with pytest.raises(BundleCorrupt, match=r"golden/0\.png is 30000x30000, expected a PNG of 32x32"):
        Bundle.load(edited(folder, change))


def test_a_score_that_is_text_is_refused() -> None:
    """At the first run, not as an error of numpy at the first press."""
    from onnx import parser

    from edge.model.bundle import Graphs
    from edge.model.bundle_writer import bundle_files

    model = parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        words (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, string[n] score)
        <int64[1] last = {3}>
        {
            pixels = Cast <to = 1> (frames)
            score_map = ReduceMean <axes = [3], keepdims = 0> (pixels)
            mean = ReduceMean <axes = [1, 2], keepdims = 0> (score_map)
            score = Cast <to = 8> (mean)
        }""")
    manifest, files = bundle_files(tiny.tiny_facts(), Graphs(detector=model.SerializeToString()))

    with pytest.raises(BundleCorrupt, match=r"and score object \(1,\), expected"):
        Scorer(Bundle.in_memory(manifest, files))


@pytest.mark.parametrize("operator", ["Loop", "RandomNormalLike", "Bernoulli"])
def test_loops_and_random_operators_are_refused(operator: str) -> None:
    """2^62 turns never end, and a random score is none. They are found before the runtime sees the graph."""
    from onnx import TensorProto, helper

    from edge.model.onnx_validation import GraphRefused, check_graph

    empty = helper.make_graph([], "body", [], [])
    attributes = {"body": empty} if operator == "Loop" else {}
    node = helper.make_node(operator, ["x"], ["y"], **attributes)
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    graph = helper.make_graph([node], "g", [value], [])

    with pytest.raises(GraphRefused, match=f"the operator {operator}"):
        check_graph(helper.make_model(graph).SerializeToString())
