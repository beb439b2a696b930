"""Unpickling without any foreign code: every class of a pickle is a stand-in that keeps what it is given.

`find_class` never imports. A name on the list gets a stand-in from here, any other name ends the reading. So a pickle
can build tables, lists, arrays and records, and nothing else.
"""

import pickle
from collections.abc import Callable
from typing import Any, ClassVar, NoReturn

from plugins.reading.tensors import DTYPES, ArrayValue, DtypeValue, StorageType, TensorValue

__all__ = ["ForbiddenGlobal", "Inert", "Unpickler", "is_allowed"]

Make = Callable[..., Any]

# Classes that files of trained detectors name. Their objects become records; nothing of these packages is imported.
RECORDS = (
    "anomalib.", "lightning.", "lightning_fabric.", "pytorch_lightning.", "torchmetrics.", "torchvision.transforms.",
    "torchvision.models.", "timm.", "torch.nn.modules.", "torch.nn.functional.", "omegaconf.", "patchcore.",
)  # fmt: skip
RECORD_NAMES = frozenset(
    {
        "torch.device", "torch.float32", "torch.float16", "torch.float64", "torch.int64", "torch.bool",
        "torch.nn.Parameter", "builtins.getattr", "__builtin__.getattr", "functools.partial", "pathlib.PosixPath",
        "pathlib.WindowsPath", "pathlib.PurePosixPath", "pathlib._local.PosixPath", "argparse.Namespace",
        "torch.utils.data.dataset.Subset", "typing.Any", "numpy.random._pickle.__randomstate_ctor",
    }
)  # fmt: skip


class ForbiddenGlobal(pickle.UnpicklingError):
    """A pickle names a function or class that no trained detector needs. name: the global."""

    def __init__(self, name: str) -> None:
        super().__init__(
            f"it names {name}, which is not on the list of what weights or a trained detector may hold; "
            "save its state_dict(), or export the network to ONNX"
        )
        self.name = name


class _Sealed(type):
    """The class of stand-in classes: a pickle cannot change one."""

    def __setattr__(cls, name: str, value: object) -> NoReturn:
        raise pickle.UnpicklingError("a pickle tries to change a class")


class Inert(metaclass=_Sealed):
    """A stand-in for an object of a foreign class: keeps arguments, state and items, and does nothing."""

    __slots__ = ("args", "items", "state")
    args: list[Any]
    items: list[Any]
    state: Any
    kind: ClassVar[str] = ""

    def __new__(cls, *args: Any, **_: Any) -> "Inert":
        made = object.__new__(cls)
        made.args, made.state, made.items = list(args), None, []
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        self.items.append([key, value])

    def append(self, value: Any) -> None:
        """Keep an item of a class that is a list."""
        self.items.append(value)

    def extend(self, values: Any) -> None:
        """Keep the items of a class that is a list."""
        self.items.extend(values)

    def add(self, value: Any) -> None:
        """Keep an item of a class that is a set."""
        self.items.append(value)


class Maker:
    """A stand-in for a function of a pickle's author, with one harmless meaning."""

    __slots__ = ("_make",)
    _make: Make

    def __init__(self, make: Make) -> None:
        object.__setattr__(self, "_make", make)

    def __call__(self, *args: Any) -> Any:
        return self._make(*args)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise pickle.UnpicklingError("a pickle tries to change a function")

    def __setstate__(self, state: object) -> NoReturn:
        raise pickle.UnpicklingError("a pickle tries to change a function")


def is_allowed(name: str) -> bool:
    """Tell whether a record of that class may be in a file."""
    return name in RECORD_NAMES or name.startswith(RECORDS)


def _encode(text: str, coding: str = "latin1") -> bytes:
    """Bytes as pickles of protocol 2 hold them."""
    return str(text).encode("latin1" if coding != "utf-8" else "utf-8")


def _frombuffer(data: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> ArrayValue:
    """An array of pickle protocol 5 in one piece. axes: their order where it is neither C nor Fortran's (NumPy 2.4)."""
    array = ArrayValue()
    array.axes = axes
    array.__setstate__((1, shape, dtype, order == "F", data))
    return array


def _rebuild_parameter(data: Any, *_: Any) -> Any:
    return data


class _Table(dict[Any, Any]):
    """A table; attributes that a pickle gives it, such as the versions of a state_dict, are left out."""

    __slots__ = ()

    def __setstate__(self, state: object) -> None:
        """Left out."""


def _table(*pairs: Any) -> dict[Any, Any]:
    return _Table(pairs[-1] if pairs and isinstance(pairs[-1], list | dict) else {})


def _make_list(*items: Any) -> list[Any]:
    return list(items[0]) if items and isinstance(items[0], list | tuple | set) else []


def _makers() -> dict[str, Any]:
    makers: dict[str, Make] = {
        "_codecs.encode": _encode,
        "torch._utils._rebuild_tensor_v2": TensorValue,
        "torch._utils._rebuild_tensor": TensorValue,
        "torch._utils._rebuild_parameter": _rebuild_parameter,
        "torch.Size": _make_list,
        "collections.OrderedDict": _table,
        "collections.defaultdict": _table,
        "builtins.dict": _table,
        **{f"{a}.{b}": _make_list for a in ("builtins", "__builtin__") for b in ("set", "frozenset", "list")},
    }
    for home in ("numpy.core", "numpy._core"):
        makers[f"{home}.multiarray._reconstruct"] = lambda *_: ArrayValue()
        makers[f"{home}.multiarray.scalar"] = lambda dtype, data=b"": _frombuffer(data, dtype, (), "C")
        makers[f"{home}.numeric._frombuffer"] = _frombuffer
    names: dict[str, Any] = {name: Maker(make) for name, make in makers.items()}
    names |= {"numpy.dtype": DtypeValue, "numpy.ndarray": ArrayValue}
    for name in DTYPES:
        names[f"torch.{name}"] = names[f"torch.storage.{name}"] = StorageType(name)
    return names


class Unpickler(pickle.Unpickler):
    """Reads one pickle into plain values and stand-ins. stored: makes a storage from its persistent id.

    Errors: ForbiddenGlobal; any other error on foreign bytes.
    """

    def __init__(self, file: Any, stored: Make | None = None, extra: dict[str, Make] | None = None) -> None:
        super().__init__(file, encoding="latin1")
        self._stored = stored
        self._known = _makers() | {name: Maker(make) for name, make in (extra or {}).items()}

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of a global. Errors: ForbiddenGlobal."""
        full = f"{module}.{name}"
        if full not in self._known:
            if not is_allowed(full):
                raise ForbiddenGlobal(full[:100])
            self._known[full] = _Sealed(name.rpartition(".")[2], (Inert,), {"__slots__": (), "kind": full})
        return self._known[full]

    def persistent_load(self, pid: Any) -> Any:
        """A tensor's storage. Errors: UnpicklingError where the file has none."""
        if self._stored is None:
            raise pickle.UnpicklingError("it refers to data outside itself")
        return self._stored(pid)
