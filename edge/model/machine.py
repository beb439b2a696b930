"""What besides the bundle and the frame decides the last bits of a score: program, libraries, processor, threads."""

import json
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from edge.model.session import saturates

__all__ = ["fingerprint", "fingerprint_bytes", "how_they_differ"]

_LIBRARIES: Final = ("gelgate", "onnxruntime", "numpy", "opencv-contrib-python-headless")


def fingerprint(threads: int) -> dict[str, Any]:
    """Plain JSON. threads: that score one press. flags: of the processor, as the system names them."""
    cpu = _cpu()
    return {
        **{name: version(name) for name in _LIBRARIES},
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": cpu.get("model name", "") or platform.processor() or platform.machine(),
        "flags": sorted((cpu.get("flags", "") or cpu.get("Features", "")).split()),
        "int8 sums saturate": saturates(),
        "threads": threads,
    }


def fingerprint_bytes(found: Mapping[str, Any]) -> bytes:
    """The one serialisation of a fingerprint."""
    return json.dumps(found, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def how_they_differ(then: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """A phrase for everything that is not the same."""
    for name in sorted(then.keys() | now.keys()):
        before, after = then.get(name), now.get(name)
        if before == after:
            continue
        if name == "flags" and isinstance(before, list) and isinstance(after, list):
            yield from _flags(set(before), set(after))
        else:
            yield f"{name} {before} then, {after} now"


def _flags(before: set[str], after: set[str]) -> Iterator[str]:
    if gone := sorted(before - after):
        yield f"the processor had {' '.join(gone)}"
    if new := sorted(after - before):
        yield f"the processor now has {' '.join(new)}"


def _cpu() -> dict[str, str]:
    """The first processor of /proc/cpuinfo; empty where there is none."""
    entries: dict[str, str] = {}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return entries
    for line in lines:
        name, _, value = line.partition(":")
        entries.setdefault(name.strip(), value.strip())
    return entries
