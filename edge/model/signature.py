"""Who made a bundle: an Ed25519 signature over its manifest, which has the SHA-256 of every other file.

`manifest.sig` is next to `manifest.json`. Ref: RFC 8032; `cryptography` computes it (extra `signing`).
"""

import base64
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import BaseModel, StringConstraints, ValidationError

from edge.core.errors import BundleCorrupt, BundleMismatch, ConfigError
from edge.extras import needs
from edge.model.archive import Archive

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

__all__ = [
    "PRIVATE_SUFFIX",
    "PUBLIC_SUFFIX",
    "SIGNATURE",
    "UNSIGNED",
    "Policy",
    "Trust",
    "fingerprint",
    "read_public_key",
    "trusted_keys",
]

SIGNATURE: Final = "manifest.sig"
PRIVATE_SUFFIX, PUBLIC_SUFFIX = ".key", ".pub"

# Signed before the manifest's bytes, so that no signature made for another purpose is one of a bundle.
CONTEXT: Final = b"gelgate bundle manifest v1\0"

_MAX_BYTES: Final = 4096
"""The largest signature and key file; a real one has some hundred bytes."""

_FINGERPRINT_CHARACTERS: Final = 16

Policy = Literal["allowed", "required"]


class SignatureFile(BaseModel, extra="forbid", frozen=True):
    """The content of `manifest.sig`. key: fingerprint of the public key. signature: base64 of 64 bytes."""

    algorithm: Literal["ed25519"]
    key: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
    signature: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9+/]{86}==$")]


UNSIGNED: Final = "not signed"


@dataclass(frozen=True)
class Trust:
    """Which bundles a gateway accepts."""

    policy: Policy = "allowed"
    keys: Mapping[str, tuple[str, "Ed25519PublicKey"]] = field(default_factory=dict)
    """Fingerprint to (name, public key)."""

    def check(self, archive: Archive, manifest: bytes) -> str:
        """Say who signed these bytes of the manifest.

        A signature by a trusted key that does not fit is refused under every policy. Errors: BundleCorrupt for such a
        signature and for an unreadable file, BundleMismatch where a trusted signature is required and there is none.
        """
        if not archive.has(SIGNATURE):
            return self._refuse_unsigned(archive, UNSIGNED)
        file = _parse(archive.read(SIGNATURE, _MAX_BYTES), archive.where)
        if file.key not in self.keys:
            text = f"signed with key {file.key}, which is not among the trusted keys: not checked"
            return self._refuse_unsigned(archive, text)
        name, key = self.keys[file.key]
        if not _fits(key, base64.b64decode(file.signature), manifest):
            raise BundleCorrupt(
                f"bundle {archive.where}: the signature of '{name}' ({file.key}) does not fit manifest.json, so the "
                "bundle was changed after it was signed; copy it again from its maker, or sign it again if the change "
                "is yours"
            )
        return f"signed by '{name}' ({file.key})"

    def _refuse_unsigned(self, archive: Archive, finding: str) -> str:
        if self.policy == "required":
            known = ", ".join(f"'{name}' ({key})" for key, (name, _) in self.keys.items()) or "none"
            raise BundleMismatch(
                f'bundle {archive.where} is {finding}, and inspection.signed = "required"; trusted keys: {known}; '
                "sign it with `gelgate bundle sign`, or add its maker's key to inspection.trusted_keys"
            )
        return finding


def trusted_keys(folder: Path) -> dict[str, tuple[str, "Ed25519PublicKey"]]:
    """Every `<name>.pub` of a folder, by fingerprint. Errors: ConfigError for no key, or a file without a key."""
    try:
        files = sorted(folder.glob(f"*{PUBLIC_SUFFIX}")) if folder.is_dir() else []
    except OSError as error:
        raise ConfigError(f"the trusted keys in {folder} cannot be read: {error.strerror}") from error
    if not files:
        raise ConfigError(
            f"there is no key in {folder}; it holds one <name>{PUBLIC_SUFFIX} per trusted maker, made by "
            "`gelgate bundle keys new`"
        )
    keys = [(file.stem, read_public_key(file)) for file in files]
    return {fingerprint(key): (name, key) for name, key in keys}


def fingerprint(key: "Ed25519PublicKey") -> str:
    """The first 16 hexadecimal digits of the SHA-256 of the raw public key (32 bytes)."""
    return hashlib.sha256(key.public_bytes_raw()).hexdigest()[:_FINGERPRINT_CHARACTERS]


def read_public_key(path: Path) -> "Ed25519PublicKey":
    """The key of `<name>.pub`. Errors: ConfigError."""
    needs("signing", "checking a signature")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    key: Ed25519PublicKey = read_key(path, "public", load_pem_public_key, Ed25519PublicKey)
    return key


def read_key(path: Path, kind: str, load: Callable[[bytes], object], wanted: type) -> Any:
    """Read the key of a small PEM file. kind: in words. Errors: ConfigError."""
    from cryptography.exceptions import UnsupportedAlgorithm

    key: object
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise ConfigError(f"{path} is no key: it has more than {_MAX_BYTES} bytes")
        key = load(data)
    except OSError as error:
        raise ConfigError(f"the key {path} cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:  # TypeError: the key has a password
        key = error
    if isinstance(key, wanted):
        return key
    what = key if isinstance(key, Exception) else type(key).__name__
    raise ConfigError(
        f"{path} is not a {kind} Ed25519 key in PEM form without a password ({what!s:.100}); "
        "`gelgate bundle keys new` makes one"
    )


def _fits(key: "Ed25519PublicKey", signature: bytes, manifest: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        key.verify(signature, CONTEXT + manifest)
    except InvalidSignature:
        return False
    return True


def _parse(raw: bytes, where: str) -> SignatureFile:
    try:
        return SignatureFile.model_validate_json(raw)
    except ValidationError as error:
        fault = error.errors()[0]
        raise BundleCorrupt(
            f"bundle {where}: {SIGNATURE} is not a signature ({'.'.join(map(str, fault['loc'])) or 'file'}: "
            f"{fault['msg']}); sign the bundle again, or remove the file"
        ) from error
