"""Press ids: ULIDs, 26 characters that sort by time (48 bits of milliseconds, then 80 random bits).

Ref: https://github.com/ulid/spec, canonical text form in Crockford's base 32.
"""

import os
import re
from collections.abc import Callable

__all__ = ["is_ulid", "new_ulid"]

_ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
_FORM = re.compile(r"[0-7][0-9A-HJKMNP-TV-Z]{25}")


def new_ulid(time_ns: int, random_bytes: Callable[[int], bytes] | None = None) -> str:
    """An id for the wall-clock moment `time_ns`. Errors: ValueError before 1970 or after the year 10889."""
    milliseconds = time_ns // 1_000_000
    if not 0 <= milliseconds < 1 << 48:
        raise ValueError(f"a ULID holds 48 bits of milliseconds since 1970, found {milliseconds}")
    number = milliseconds << 80 | int.from_bytes((random_bytes or os.urandom)(10), "big")
    return "".join(_ALPHABET[number >> shift & 31] for shift in range(125, -1, -5))


def is_ulid(text: str) -> bool:
    """Tell whether the text is a ULID in canonical form."""
    return _FORM.fullmatch(text) is not None
