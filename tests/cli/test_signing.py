"""`gelgate bundle keys`, `gelgate bundle sign`, and what `inspect`, `verify` and `check` say of a signature."""

from pathlib import Path

import pytest
from breakable_station import Bench
from command_line import gelgate, ran

pytest.importorskip("cryptography", reason="signatures need the extra `signing`")


@pytest.fixture
def keys(bench: Bench) -> Path:
    """The folder of trusted keys of a station that requires a signature; the private key is elsewhere."""
    assert gelgate("bundle", "keys", "new", "line4").code == 0
    Path("trusted").mkdir()
    Path("line4.pub").rename("trusted/line4.pub")
    return Path("trusted")


def with_inspection(bench: Bench, lines: str) -> None:
    """The station's configuration with these lines in [inspection]."""
    path = bench.config()
    path.write_text(path.read_text().replace("[inspection]\n", f"[inspection]\n{lines}\n"))


def test_from_a_new_key_to_a_station_that_requires_it(bench: Bench, keys: Path) -> None:
    """An unsigned bundle is refused at the start with the command that signs it; signed, it is accepted."""
    with_inspection(bench, 'signed = "required"\ntrusted_keys = "trusted"')
    refused = gelgate("check", "-c", "gelgate.toml")
    assert refused.code == 3
    assert "not signed" in refused.out
    assert "gelgate bundle sign" in refused.out

    signed = gelgate("bundle", "sign", "bundle", "--key", "line4.key")
    assert (signed.code, signed.err) == (0, "")
    accepted = gelgate("check", "-c", "gelgate.toml")
    assert "signed by 'line4'" in accepted.out
    assert accepted.code == 0


def test_required_of_nobody_is_a_fault(bench: Bench) -> None:
    """A policy without a key would refuse every bundle."""
    with_inspection(bench, 'signed = "required"')
    done = gelgate("check", "-c", "gelgate.toml")
    assert done.code == 3
    assert "needs trusted_keys" in done.err


def test_inspect_and_verify_name_the_maker(bench: Bench, keys: Path) -> None:
    """Not signed: exit code 5. Without keys the signature is not checked, which is said; with them it is."""
    unsigned = gelgate("bundle", "verify", "bundle", "--keys", "trusted")
    assert (unsigned.code, "not signed" in unsigned.err) == (5, True)
    ran("bundle", "sign", "bundle", "--key", "line4.key")
    assert "not checked" in ran("bundle", "inspect", "bundle")
    for verb in ("inspect", "verify"):
        assert "signed by 'line4'" in ran("bundle", verb, "bundle", "--keys", "trusted")


def test_a_damaged_bundle_is_not_signed(bench: Bench, keys: Path) -> None:
    """A signature says that the maker has seen the bundle sound."""
    (Path("bundle") / "head.onnx").write_bytes(b"")
    done = gelgate("bundle", "sign", "bundle", "--key", "line4.key")
    assert done.code == 3
    assert not (Path("bundle") / "manifest.sig").exists()


def test_keys_are_shown_and_never_replaced(bench: Bench, keys: Path) -> None:
    """The fingerprints of a folder are those of its files."""
    shown = ran("bundle", "keys", "show", "trusted")
    assert shown == ran("bundle", "keys", "show", "trusted/line4.pub")
    assert "line4" in shown
    before = Path("line4.key").read_bytes()
    done = gelgate("bundle", "keys", "new", "line4")
    assert (done.code, "not replaced" in done.sentence()) == (3, True)
    assert Path("line4.key").read_bytes() == before
