"""onnxruntime sessions with fixed options, the trunks that bundles share, and what decides the last bits of a score."""

import json
import platform
import threading
from collections.abc import Container, Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
import onnxruntime as ort

from edge.core.errors import BundleCorrupt
from edge.extras import find_version
from edge.model.onnx_validation import GraphRefused, check_graph

__all__ = [
    "RUNTIME_ERRORS",
    "TrunkSessions",
    "fingerprint",
    "fingerprint_bytes",
    "how_they_differ",
    "open_session",
    "read_cpu",
    "saturates",
]

RUNTIME_ERRORS: tuple[type[Exception], ...] = (
    *(
        kind
        for kind in vars(ort.capi.onnxruntime_pybind11_state).values()
        if isinstance(kind, type) and issubclass(kind, Exception)
    ),
    RuntimeError,
    ValueError,
)
"""The exceptions of onnxruntime, which have no common base class."""


def open_session(graph: bytes, threads: int, where: str) -> ort.InferenceSession:
    """A session for untrusted bytes with fixed options. `where` names the file in errors.

    Spinning threads are off: on a shared two-core gateway they gave a worst case of 53.9 ms against 39.9 with the
    same median. All sessions have one arena: shapes are fixed, so it does not grow. A plan of the memory, made after
    the first run, would take another 14 MB beside what that has taken, for the same time. Denormals as zero, a graph
    that was optimised before, and one graph of trunk and head with the bank as constants change the processor time by
    less than 2 %. Errors: BundleCorrupt.
    """
    _share_arena()
    options = ort.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.enable_mem_pattern = False
    options.log_severity_level = 3  # errors only: gelgate's own messages cover the rest
    options.use_deterministic_compute = True
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if saturates():
        options.add_session_config_entry("session.x64quantprecision", "1")
    try:
        check_graph(graph)
        return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except GraphRefused as error:
        raise BundleCorrupt(f"{where} is refused: {error}; export it again") from error
    except RUNTIME_ERRORS as error:
        first_line = str(error).strip().partition("\n")[0][:300] or type(error).__name__
        raise BundleCorrupt(
            f"{where} cannot be run by onnxruntime {ort.__version__}: {first_line}"
        ) from error


@cache
def _share_arena() -> None:
    """Make the arena that all sessions share, which grows by what is asked for: one for each, which grows by powers of
    two, took 5 MB more with one bundle and 3 MB more with each further one."""
    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    as_asked, default = 1, -1
    ort.create_and_register_allocator(place, ort.OrtArenaCfg(0, as_asked, default, default))


@cache
def saturates() -> bool:
    """Tell whether onnxruntime lets the 16-bit sums of int8 products saturate here, as it does on x86 without VNNI.

    Tried on a convolution in which every product is near the maximum. Such a processor needs wider sums, with which an
    int8 trunk takes twice as long (measured: 5.1 to 10.6 ms on one core), so others do not use them.
    """
    probe = files("edge.model").joinpath("saturation_probe.onnx").read_bytes()
    session = ort.InferenceSession(probe, providers=["CPUExecutionProvider"])
    (sums,) = session.run(None, {"x": np.ones((1, 8, 3, 3), np.float32)})
    return bool(np.abs(sums - _PROBE_SUM).max() > 1)


# 8 channels and 3x3 places of one times one.
_PROBE_SUM = 72


class TrunkSessions:
    """Open trunks by the SHA-256 of their file, so that bundles with the same backbone share one session.

    Make one per gateway and give it to every `Scorer` and to `Bundle.load(loaded=...)`. Any thread may use it:
    onnxruntime runs one session from several threads, each with its own buffers.
    """

    def __init__(self, threads: int = 2) -> None:
        self.threads = threads
        self._sessions: dict[str, ort.InferenceSession] = {}
        self._lock = threading.Lock()

    def __contains__(self, sha256: object) -> bool:
        return sha256 in self._sessions

    def get(self, sha256: str, graph: bytes | None, where: str) -> ort.InferenceSession:
        """The session of a trunk, opened at its first use. Errors: BundleCorrupt."""
        with self._lock:
            if sha256 not in self._sessions:
                if graph is None:
                    raise BundleCorrupt(f"{where}: the trunk {sha256[:12]} was not loaded with the bundle")
                self._sessions[sha256] = open_session(graph, self.threads, where)
            return self._sessions[sha256]

    def keep_only(self, used: Container[str | None]) -> None:
        """Forget the trunks that no bundle uses any more; their memory is freed with the last scorer that has them."""
        with self._lock:
            self._sessions = {sha256: session for sha256, session in self._sessions.items() if sha256 in used}


_LIBRARIES: Final = ("gelgate", "onnxruntime", "numpy", "opencv-contrib-python-headless")


def fingerprint(threads: int) -> dict[str, Any]:
    """Plain JSON. threads: that score one press. flags: of the processor, as the system names them."""
    cpu = read_cpu()
    return {
        **{name: find_version(name) for name in _LIBRARIES},
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
            if gone := sorted(set(before) - set(after)):
                yield f"the processor had {' '.join(gone)}"
            if new := sorted(set(after) - set(before)):
                yield f"the processor now has {' '.join(new)}"
        else:
            yield f"{name} {before} then, {after} now"


def read_cpu() -> dict[str, str]:
    """Read the first processor of /proc/cpuinfo; empty where there is none."""
    entries: dict[str, str] = {}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return entries
    for line in lines:
        name, _, value = line.partition(":")
        entries.setdefault(name.strip(), value.strip())
    return entries
