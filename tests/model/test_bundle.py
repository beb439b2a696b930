"""A bundle: equal inputs give equal bytes, and every change in it is found and named."""

import dataclasses
import hashlib
import io
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny

from edge.core.errors import BundleCorrupt, BundleMismatch, FitError
from edge.model.archive import MANIFEST
from edge.model.bundle import Bundle, GoldenFrame
from edge.model.bundle_writer import bundle_files, write_bundle
from edge.model.manifest import SCHEMA_VERSION
from edge.model.scorer import Scorer
from edge.pictures.nominal_pictures import NominalPictures

GOLDEN = GoldenFrame(tiny.presses(1)[0], "a press", 0.5, ((0.5,),))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A complete bundle with an int8 bank and a golden frame, as a folder."""
    _, files = tiny.tiny_files(tiny.tiny_bank(packing="int8"), golden=[GOLDEN])
    return write_bundle(tmp_path / "bolt", files)


def test_equal_inputs_give_equal_bytes() -> None:
    first, second = (tiny.tiny_files(golden=[GOLDEN])[1] for _ in range(2))
    assert first == second


@pytest.mark.parametrize("name", ["bolt", "bolt.zip"])
def test_a_written_bundle_is_loaded(tmp_path: Path, name: str) -> None:
    """Folder and zip give the manifest, graphs, unpacked bank and golden frames that were written."""
    manifest, files = tiny.tiny_files(golden=[GOLDEN])
    bundle = Bundle.load(write_bundle(tmp_path / name, files))
    assert bundle.manifest == manifest
    assert bundle.graphs.trunk == tiny.tiny_trunk()
    assert bundle.profile == tiny.PROFILE
    assert bundle.region == tiny.REGION
    assert bundle.grid == tiny.tiny_grid()
    np.testing.assert_array_equal(bundle.bank["mean"], tiny.tiny_bank().arrays["mean"])
    np.testing.assert_array_equal(bundle.golden[0].rgb, GOLDEN.rgb)


def test_the_digest_tells_bundles_apart(tmp_path: Path) -> None:
    """The bundle's identity is the same from folder and zip, and another for another threshold."""
    _, files = tiny.tiny_files()
    _, others = tiny.tiny_files(threshold=0.06)
    a, b, c = (
        Bundle.load(write_bundle(tmp_path / name, f)).digest
        for name, f in (("a", files), ("b.zip", files), ("c", others))
    )
    assert a == b != c


def test_the_manifest_states_bytes_stored_and_in_use(folder: Path) -> None:
    """int8 with one scale per row: 48 values and 12 scales against 192 bytes unpacked, headers included."""
    entry = Bundle.load(folder).manifest.bank["mean"]
    assert entry.bytes_unpacked == 3 * 4 * 4 * 4
    assert entry.scale is not None
    assert entry.bytes_stored == sum((folder / f.file).stat().st_size for f in (entry.data, entry.scale))


FILES = ["trunk.onnx", "head.onnx", "bank/mean.npy", "bank/mean.scale.npy", "golden/0.png"]


CHANGED = r"{file} has SHA-256 [0-9a-f]{{12}} .* expects [0-9a-f]{{12}}"
DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "changed": (
        lambda path: path.write_bytes(path.read_bytes()[:-1] + bytes([path.read_bytes()[-1] ^ 1])),
        CHANGED,
    ),
    "missing": (Path.unlink, "{file} is missing"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:-10]), "{file}"),
}


@pytest.mark.parametrize(("file", "damage"), [*itertools.product(FILES, DAMAGES), (MANIFEST, "missing")])
def test_damage_of_any_file_is_named(folder: Path, file: str, damage: str) -> None:
    """One changed byte, a bundle copied in part, an interrupted copy."""
    change, sentence = DAMAGES[damage]
    change(folder / file)
    with pytest.raises(BundleCorrupt, match=sentence.format(file=file)):
        Bundle.load(folder)


def with_bank_file(data: bytes) -> tuple[object, dict[str, bytes]]:
    """A bundle whose bank file holds these bytes, with a manifest that agrees to their hash."""
    manifest, files = tiny.tiny_files()
    entry = manifest.bank["mean"]
    forged = entry.data.model_copy(
        update={"sha256": hashlib.sha256(data).hexdigest(), "size_bytes": len(data)}
    )
    bank = {"mean": entry.model_copy(update={"data": forged})}
    return manifest.model_copy(update={"bank": bank}), {**files, "bank/mean.npy": data}


def npy(array: np.ndarray, allow_pickle: bool = False) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=allow_pickle)
    return stream.getvalue()


MEAN = np.full((3, 4, 4), 0.5, np.float32)
NAN = np.where(np.arange(48).reshape(3, 4, 4) == 7, np.float32(np.nan), MEAN)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (npy(np.full((3, 4, 4), None, object), allow_pickle=True), "holds object"),
        (npy(MEAN)[:-8], "184 bytes of data, 192 were expected"),
        (npy(MEAN) + b"more", "196 bytes of data, 192 were expected"),
        (npy(MEAN.astype(np.float64)), r"holds float64 \(3, 4, 4\), the manifest expects float32"),
        (npy(MEAN.reshape(3, 16)), r"holds float32 \(3, 16\), the manifest expects float32 \(3, 4, 4\)"),
        (npy(np.asfortranarray(MEAN)), "the manifest expects float32"),
        (npy(NAN), "NaN or infinity"),
        (b"\x80\x04N.", "not a npy file"),
        (b"", "not a npy file"),
    ],
    ids=["pickle", "cut", "longer", "dtype", "shape", "order", "nan", "bare pickle", "empty"],
)
def test_a_bank_file_that_is_not_what_the_manifest_says_is_refused(data: bytes, reason: str) -> None:
    """Even with the right hash nothing in a bank is unpickled, and every header is checked."""
    manifest, files = with_bank_file(data)
    with pytest.raises(BundleCorrupt, match=reason):
        Bundle.in_memory(manifest, files)  # type: ignore[arg-type]


def test_a_newer_schema_is_refused_by_name(folder: Path) -> None:
    """A gateway that is too old says so, not that the bundle is damaged."""
    content = json.loads((folder / MANIFEST).read_text())
    content |= {"schema_version": SCHEMA_VERSION + 1, "unheard_of": True}
    (folder / MANIFEST).write_text(json.dumps(content))
    says = rf"schema {SCHEMA_VERSION + 1}, this program reads up to {SCHEMA_VERSION}"
    with pytest.raises(BundleMismatch, match=says):
        Bundle.load(folder)


@pytest.mark.parametrize("text", ["", "[]", "nonsense", "[" * 100_000, '{"schema_version": "1"}'])
def test_a_manifest_that_is_no_json_object_is_refused(folder: Path, text: str) -> None:
    (folder / MANIFEST).write_text(text)
    with pytest.raises(BundleCorrupt, match=r"manifest\.json"):
        Bundle.load(folder)


def test_a_bundle_without_its_trunk_finds_it_by_hash(tmp_path: Path) -> None:
    """In the store that is given, next to the bundle, or open already; checked by its bytes, not by its name."""
    manifest, files = tiny.tiny_files(with_trunk=False)
    assert "trunk.onnx" not in files
    assert manifest.backbone is not None
    sha256 = manifest.backbone.trunk.sha256
    slim = write_bundle(tmp_path / "bolt.zip", files)

    with pytest.raises(BundleCorrupt, match=r"copy it there as [0-9a-f]{64}\.onnx"):
        Bundle.load(slim, tmp_path)
    assert Bundle.load(slim, loaded={sha256}).graphs.trunk is None
    for store in (tmp_path / "store", tmp_path / "trunks"):  # the second one needs no setting
        store.mkdir()
        (store / f"{sha256}.onnx").write_bytes(tiny.tiny_trunk())
        assert Bundle.load(slim, *[store][: store.name == "store"]).graphs.trunk == tiny.tiny_trunk()
        (store / f"{sha256}.onnx").write_bytes(tiny.tiny_trunk()[:-1] + b"?")
        with pytest.raises(BundleCorrupt, match="SHA-256"):
            Bundle.load(slim, store)
        (store / f"{sha256}.onnx").unlink()


def test_a_bank_that_cannot_be_stored_is_a_fit_error() -> None:
    """A dtype that no head accepts is refused when the bundle is made, not on the line."""
    bank = tiny.tiny_bank()
    wrong = dataclasses.replace(bank, arrays={"mean": bank.arrays["mean"].astype(np.float64)})
    with pytest.raises(FitError, match="float64"):
        bundle_files(tiny.tiny_facts(), tiny.tiny_graphs(), wrong, backbone="tiny")


def test_a_file_replaced_after_loading_changes_nothing(folder: Path) -> None:
    """The checked bytes are the ones that score: nothing is read or mapped later, even when the files are removed."""
    scorer = Scorer(Bundle.load(folder))
    before = scorer.score(GOLDEN.rgb).anomaly_score
    (folder / "bank" / "mean.npy").write_bytes(b"")
    (folder / "trunk.onnx").unlink()
    assert scorer.score(GOLDEN.rgb).anomaly_score == before


def test_a_picture_that_is_not_square_comes_back() -> None:
    """The free gel as contact detection sees it, 120 rows of 160."""
    view = np.random.default_rng(0).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    parts = (tiny.tiny_facts(), tiny.tiny_graphs(), tiny.tiny_bank())
    manifest, files = bundle_files(*parts, backbone="tiny", free_view=view)
    found = Bundle.in_memory(manifest, files).free_view

    assert found is not None
    assert np.array_equal(found, view)


def pictured(**changes: Any) -> Bundle:
    """A bundle with two pictures of nominal presses, and with changes of what its manifest says of them."""
    pictures = NominalPictures.of(tiny.presses(2), ("a", "b"), is_mean=False)
    parts = (tiny.tiny_facts(), tiny.tiny_graphs(), tiny.tiny_bank())
    manifest, files = bundle_files(*parts, backbone="tiny", nominal_pictures=pictures)
    entry = manifest.nominal_pictures
    assert entry is not None
    manifest = manifest.model_copy(update={"nominal_pictures": entry.model_copy(update=changes)})
    return Bundle.in_memory(manifest, files)


def test_pictures_of_nominal_presses_come_back_and_change_no_score() -> None:
    """What people are shown: the same bytes, sizes and names; the score is that of a bundle without, bit for bit."""
    found, plain = pictured(), Bundle.in_memory(*tiny.tiny_files())

    assert found.nominal_pictures == NominalPictures.of(tiny.presses(2), ("a", "b"), is_mean=False)
    assert plain.nominal_pictures is None
    maps = [Scorer(bundle).score(GOLDEN.rgb).score_map for bundle in (found, plain)]
    assert maps[0].tobytes() == maps[1].tobytes()


@pytest.mark.parametrize("changes", [{"names": ("a", "b", "c")}, {"size": (16, 16)}])
def test_pictures_of_another_size_than_stated_are_refused(changes: dict[str, Any]) -> None:
    """A strip of two small pictures that is said to be another: never a comparison with half of two presses."""
    with pytest.raises(BundleCorrupt, match=r"pictures\.jpg"):
        pictured(**changes)
