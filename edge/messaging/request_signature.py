"""The signature of a request: HMAC-SHA256 with a secret that the station and the asker share.

Ref: RFC 2104 and FIPS 180-4. What is signed is one JSON text with sorted keys, no blanks and `\\u` for everything that
is not ASCII, so that programs in any language make the same bytes:

    {"arguments":{},"by":null,"root":"<root>","time_ns":1,"transaction":"t","verb":"relearn"}

The root is that of the station's topics: a request for one station is not valid at another with the same secret.
"""

import hashlib
import hmac
import json
from collections.abc import Mapping
from typing import Any, Final

__all__ = ["SHORTEST_SECRET", "is_signed", "signature_of", "signed_text"]

# A secret of fewer bytes could be guessed from one request.
SHORTEST_SECRET: Final = 16


def signed_text(
    root: str, verb: str, transaction: str, time_ns: int, by: str | None, arguments: Mapping[str, Any]
) -> bytes:
    """The bytes that are signed."""
    content = {
        "arguments": dict(arguments),
        "by": by,
        "root": root,
        "time_ns": time_ns,
        "transaction": transaction,
        "verb": verb,
    }
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()


def signature_of(secret: bytes, text: bytes) -> str:
    """64 hexadecimal digits."""
    return hmac.new(secret, text, hashlib.sha256).hexdigest()


def is_signed(secret: bytes, text: bytes, signature: str) -> bool:
    """Compared in constant time."""
    return hmac.compare_digest(signature_of(secret, text), signature)
