"""The machine of a run: what it is, and how fast it can be at most."""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from edge.model.session import open_session, read_cpu

__all__ = ["Peak", "best", "busy", "fastest", "fingerprint", "probe", "read_peak_bytes"]

SIDE: Final = 512
"""Of the square matrices that are multiplied: they stay in the cache, and a product is over within a time slice."""

CHANNELS, MAP_SIDE, KERNEL = 64, 56, 3
"""Of the convolution that is measured as well: one of the first layers of a ResNet on 224x224."""

COPIED: Final = 128 << 20
"""Bytes that are copied: four times the largest cache of the machines seen."""

LIBRARIES: Final = ("gelgate", "numpy", "onnxruntime", "opencv-contrib-python-headless")


@dataclass(frozen=True)
class Peak:
    """The fastest that this machine was seen to be: operations and bytes per second.

    A multiplication and an addition are two operations.
    """

    float32_per_s: float
    int8_per_s: float
    bytes_per_s: float
    """Read and written together, by one thread."""


def fingerprint(threads: int) -> dict[str, Any]:
    """Everything known to change a time: processor, its flags, threads, libraries, governor, system."""
    cpu = read_cpu()
    return {
        "processor": cpu.get("model name", platform.processor() or platform.machine()),
        "flags": sorted(cpu.get("flags", "").split()),
        "cores": os.cpu_count(),
        "threads": threads,
        "governor": _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") or "not shown",
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in LIBRARIES},
        "load_at_start": round(os.getloadavg()[0], 2),
    }


def busy(machine: dict[str, Any]) -> str:
    """A sentence where other work took the cores while a run began, otherwise nothing."""
    load, cores = machine["load_at_start"], machine["cores"]
    if load <= cores / 2:
        return ""
    return (
        f"The machine was busy (load {load:g} on {cores} cores): milliseconds are longer than on a quiet one."
    )


def _read(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def read_peak_bytes(process: int | str) -> int | None:
    """Return the largest resident size so far of a process, an id or `self`; None where the system does not show it."""
    lines = _read(f"/proc/{process}/status").splitlines()
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM")), None)


def probe(threads: int, repeats: int = 40) -> Peak:
    """Measure the peak: the fastest of many short products and copies, so that other work counts least.

    In float32 the better of a matrix product and a convolution counts, so that no trunk is faster than its floor.
    """
    rng = np.random.default_rng(0)
    real = rng.normal(size=(SIDE, SIDE)).astype(np.float32)
    maps = rng.normal(size=(1, CHANNELS, MAP_SIDE, MAP_SIDE)).astype(np.float32)
    kernels = rng.normal(size=(CHANNELS, CHANNELS, KERNEL, KERNEL)).astype(np.float32)
    unsigned, signed = (rng.integers(0, 100, (SIDE, SIDE), dtype) for dtype in (np.uint8, np.int8))
    product, convolution = 2 * SIDE**3, 2 * maps.size * kernels[0].size
    return Peak(
        float32_per_s=max(
            product / _product("MatMul", real, real, threads, repeats),
            convolution / _product("Conv", maps, kernels, threads, repeats, pads=[KERNEL // 2] * 4),
        ),
        int8_per_s=product / _product("MatMulInteger", unsigned, signed, threads, repeats),
        bytes_per_s=2 * COPIED / _copy(repeats // 4),
    )


def best(*peaks: Peak) -> Peak:
    """The fastest that any of the probes saw."""
    return Peak(*(max(values) for values in zip(*map(astuple, peaks), strict=True)))


def _product(kind: str, left: Any, right: Any, threads: int, repeats: int, **attributes: Any) -> float:
    """Seconds of one product in onnxruntime, the fastest; the right factor is constant, as weights are."""
    from onnx import TensorProto, helper, numpy_helper

    result = TensorProto.FLOAT if left.dtype == np.float32 else TensorProto.INT32
    graph = helper.make_graph(
        [helper.make_node(kind, ["a", "b"], ["c"], **attributes)],
        "probe",
        [helper.make_tensor_value_info("a", helper.np_dtype_to_tensor_dtype(left.dtype), left.shape)],
        [helper.make_tensor_value_info("c", result, None)],
        initializer=[numpy_helper.from_array(right, "b")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    session = open_session(model.SerializeToString(), threads, "the probe")
    return fastest(lambda: session.run(None, {"a": left}), repeats)


def _copy(repeats: int) -> float:
    source, target = np.ones(COPIED, np.uint8), np.empty(COPIED, np.uint8)
    return fastest(lambda: np.copyto(target, source), repeats)


def fastest(work: Callable[[], object], repeats: int) -> float:
    """Return the seconds of the fastest of some runs, after one that warms up."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])
