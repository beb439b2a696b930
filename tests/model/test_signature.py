"""A signature says who made a bundle; any later change of the bundle makes it invalid."""

import base64
import json
from pathlib import Path

import pytest
import tiny

from edge.core.errors import BundleCorrupt, BundleMismatch, ConfigError
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, Bundle
from edge.model.bundle_writer import add_file, write_bundle
from edge.model.signature import SIGNATURE, Trust, fingerprint, read_public_key, trusted_keys
from edge.model.signing import new_key, read_private_key, sign

pytest.importorskip("cryptography", reason="signatures need the extra `signing`")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A folder with the key pair `line4`."""
    folder = tmp_path / "keys"
    folder.mkdir()
    new_key(folder / "line4")
    return folder


def signed(path: Path, key: Path) -> Path:
    """A tiny bundle, signed with that key."""
    write_bundle(path, tiny.tiny_files()[1])
    raw = open_archive(path).read(MANIFEST, MAX_MANIFEST_BYTES)
    add_file(path, SIGNATURE, sign(raw, read_private_key(key)))
    return path


def required(keys: Path) -> Trust:
    return Trust("required", trusted_keys(keys))


@pytest.mark.parametrize("name", ["bolt", "bolt.zip"])
def test_a_signed_bundle_names_its_maker(tmp_path: Path, keys: Path, name: str) -> None:
    """From a folder and from a zip, and the bundle is otherwise the same."""
    bundle = Bundle.load(signed(tmp_path / name, keys / "line4.key"), trust=required(keys))

    mark = fingerprint(read_public_key(keys / "line4.pub"))
    assert bundle.signature == f"signed by 'line4' ({mark})"
    assert bundle.digest == Bundle.load(write_bundle(tmp_path / "plain", tiny.tiny_files()[1])).digest


@pytest.mark.parametrize("policy", ["allowed", "required"])
def test_a_change_after_the_signature_is_refused(tmp_path: Path, keys: Path, policy: str) -> None:
    """A raised threshold, under either policy; the same bundle without a signature is sound."""
    path = signed(tmp_path / "bolt", keys / "line4.key")
    manifest = json.loads((path / MANIFEST).read_text())
    manifest["threshold"]["value"] = 1e9
    (path / MANIFEST).write_text(json.dumps(manifest))

    with pytest.raises(BundleCorrupt, match="changed after it was signed"):
        Bundle.load(path, trust=Trust(policy, trusted_keys(keys)))  # type: ignore[arg-type]
    (path / SIGNATURE).unlink()
    assert Bundle.load(path).manifest.threshold.value == 1e9


def test_an_unsigned_bundle_is_refused_where_a_signature_is_required(tmp_path: Path, keys: Path) -> None:
    """And accepted where it is allowed to be unsigned, which is said."""
    path = write_bundle(tmp_path / "bolt", tiny.tiny_files()[1])

    with pytest.raises(BundleMismatch, match=r"not signed.*'line4'.*gelgate bundle sign"):
        Bundle.load(path, trust=required(keys))
    assert Bundle.load(path).signature == "not signed"


def test_a_key_that_is_not_trusted_counts_for_nothing(tmp_path: Path, keys: Path) -> None:
    """Required: refused. Allowed: accepted as not checked, because nothing is known of that key."""
    new_key(tmp_path / "stranger")
    path = signed(tmp_path / "bolt", tmp_path / "stranger.key")

    with pytest.raises(BundleMismatch, match="not among the trusted keys"):
        Bundle.load(path, trust=required(keys))
    found = Bundle.load(path, trust=Trust("allowed", trusted_keys(keys))).signature
    assert "not checked" in found


def change_signature(path: Path, **fields: str) -> None:
    (path / SIGNATURE).write_text(json.dumps(json.loads((path / SIGNATURE).read_text()) | fields))


def test_a_signature_of_another_key_or_purpose_does_not_fit(tmp_path: Path, keys: Path) -> None:
    """The fingerprint chooses the key, which has to fit; over the manifest alone another program could sign."""
    new_key(tmp_path / "stranger")
    forged = signed(tmp_path / "forged", tmp_path / "stranger.key")
    change_signature(forged, key=fingerprint(read_public_key(keys / "line4.pub")))
    foreign = signed(tmp_path / "foreign", keys / "line4.key")
    bare = read_private_key(keys / "line4.key").sign((foreign / MANIFEST).read_bytes())
    change_signature(foreign, signature=base64.b64encode(bare).decode())

    for path in (forged, foreign):
        with pytest.raises(BundleCorrupt, match="does not fit"):
            Bundle.load(path, trust=required(keys))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"\xff\xfe",
        b"[" * 4000,
        b" " * 5000,
        b'{"algorithm":"none","key":"0000000000000000","signature":""}',
    ],
)
def test_a_file_that_is_no_signature_is_refused(tmp_path: Path, keys: Path, content: bytes) -> None:
    """Also where no signature is required: somebody meant to sign."""
    path = signed(tmp_path / "bolt", keys / "line4.key")
    (path / SIGNATURE).write_bytes(content)

    with pytest.raises(BundleCorrupt, match=r"manifest\.sig"):
        Bundle.load(path, trust=Trust("allowed", trusted_keys(keys)))


def test_a_link_in_place_of_the_signature_is_refused(tmp_path: Path, keys: Path) -> None:
    """A link that leads nowhere must not pass for an unsigned bundle."""
    path = signed(tmp_path / "bolt", keys / "line4.key")
    (path / SIGNATURE).unlink()
    (path / SIGNATURE).symlink_to(tmp_path / "nowhere")

    with pytest.raises(BundleCorrupt, match=r"manifest\.sig"):
        Bundle.load(path)


def test_a_private_key_is_its_owners_alone_and_never_replaced(keys: Path) -> None:
    """0600 from its first byte on; a lost private key cannot be had again."""
    before = (keys / "line4.key").read_bytes()
    assert (keys / "line4.key").stat().st_mode & 0o777 == 0o600
    with pytest.raises(FileExistsError):
        new_key(keys / "line4")
    assert (keys / "line4.key").read_bytes() == before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not a"),
        (b"-----BEGIN PUBLIC KEY-----\nAAAA\n-----END PUBLIC KEY-----\n", "is not a"),
        (b"x" * 4097, "it has more than 4096 bytes"),
    ],
)
def test_a_file_that_is_no_key_is_refused(keys: Path, content: bytes, words: str) -> None:
    """In the folder of trusted keys as well as for signing."""
    (keys / "other.pub").write_bytes(content)
    (keys / "other.key").write_bytes(content)

    with pytest.raises(ConfigError, match=rf"other\.pub {words}|other\.pub is no key: {words}"):
        trusted_keys(keys)
    with pytest.raises(ConfigError, match=rf"other\.key {words}|other\.key is no key: {words}"):
        read_private_key(keys / "other.key")


def test_a_key_of_another_kind_is_refused(keys: Path) -> None:
    """A private key in place of the public one, and the other way round."""
    (keys / "swapped.pub").write_bytes((keys / "line4.key").read_bytes())
    with pytest.raises(ConfigError, match=r"swapped\.pub is not a public"):
        trusted_keys(keys)
    with pytest.raises(ConfigError, match=r"line4\.pub is not a private"):
        read_private_key(keys / "line4.pub")


def test_a_folder_without_keys_is_refused(tmp_path: Path) -> None:
    """Nobody is trusted, so no bundle could ever be accepted."""
    with pytest.raises(ConfigError, match=r"there is no key in"):
        trusted_keys(tmp_path)
