"""Signs bundles, and makes the keys: `edge.model.signature` checks them."""

import base64
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from edge.extras import needs
from edge.model.signature import (
    CONTEXT,
    PRIVATE_SUFFIX,
    PUBLIC_SUFFIX,
    SignatureFile,
    fingerprint,
    read_key,
)

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

__all__ = ["new_key", "read_private_key", "sign"]


def sign(manifest: bytes, key: "Ed25519PrivateKey") -> bytes:
    """The content of `manifest.sig` for these bytes of the manifest."""
    signature = base64.b64encode(key.sign(CONTEXT + manifest)).decode()
    file = SignatureFile(algorithm="ed25519", key=fingerprint(key.public_key()), signature=signature)
    return (file.model_dump_json() + "\n").encode()


def new_key(path: Path) -> str:
    """Write `<path>.key` (PKCS #8, for its owner alone) and `<path>.pub`; returns the fingerprint.

    An existing file is never replaced. Errors: FileExistsError, OSError; ConfigError without the extra `signing`.
    """
    needs("signing", "a key")
    from cryptography.hazmat.primitives import serialization as form
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption())
    public = key.public_key().public_bytes(form.Encoding.PEM, form.PublicFormat.SubjectPublicKeyInfo)
    _write_new(path.with_name(path.name + PRIVATE_SUFFIX), private, 0o600)
    _write_new(path.with_name(path.name + PUBLIC_SUFFIX), public, 0o644)
    return fingerprint(key.public_key())


def read_private_key(path: Path) -> "Ed25519PrivateKey":
    """The key of `<name>.key`. Errors: ConfigError."""
    needs("signing", "signing a bundle")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    load = partial(load_pem_private_key, password=None)
    key: Ed25519PrivateKey = read_key(path, "private", load, Ed25519PrivateKey)
    return key


def _write_new(path: Path, data: bytes, mode: int) -> None:
    """Create a file with these rights from its first byte on. Errors: FileExistsError, OSError."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(data)
