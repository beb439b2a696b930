"""Pickles are read without running anything that is in them."""

import io
import os
import pickle
import struct
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.core.errors import ConfigError
from plugins.reading.child import decode, encode
from plugins.reading.files import read_here
from plugins.reading.foreign import Record
from plugins.reading.inert import ForbiddenGlobal, Unpickler
from plugins.reading.isolated import read_foreign
from plugins.reading.torch_files import MAGIC, PROTOCOL, read_stream


class Call:
    """Pickles as a call of a function."""

    def __init__(self, function: Any, *args: Any) -> None:
        self.reduced = function, args

    def __reduce__(self) -> Any:
        return self.reduced


def written(folder: Path, content: Any, protocol: int = 4, name: str = "model.pkl") -> Path:
    path = folder / name
    path.write_bytes(pickle.dumps(content, protocol))
    return path


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (os.system, "system"),
        (eval, "eval"),
        (exec, "exec"),
        (open, "open"),
        (__import__, "__import__"),
        (pickle.loads, "loads"),
        (os.remove, "remove"),
    ],
)
def test_a_function_of_the_author_is_named_and_never_called(tmp_path: Path, function: Any, name: str) -> None:
    """The canary stays away: neither a file of it nor a changed folder, and the sentence has the global's name."""
    canary = tmp_path / "canary"
    text = f"open({str(canary)!r}, 'w').close()"
    given = {"eval": text, "exec": text, "system": f"touch {canary}", "open": str(canary), "loads": b"N."}
    path = written(tmp_path, {"mean": np.zeros(3), "x": Call(function, given.get(name, str(canary)))})
    before = sorted(tmp_path.iterdir())

    with (
        pytest.raises(
            ConfigError, match=rf"model\.pkl was not imported: it names \S*{name}, which is not on the list"
        ),
        read_foreign(path),
    ):
        pass
    assert sorted(tmp_path.iterdir()) == before


def test_classes_of_known_programs_become_records(tmp_path: Path) -> None:
    """An object of torchvision is its name and attributes, and torchvision is not looked for."""
    pickled = b"\x80\x02ctorchvision.transforms.v2._geometry\nResize\n)\x81}(X\x04\x00\x00\x00sizeK\x20ub."
    (tmp_path / "a.pkl").write_bytes(pickled)

    _, found = read_here(tmp_path / "a.pkl")

    assert found == Record("torchvision.transforms.v2._geometry.Resize", [], {"size": 32})


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("dtype", ["float32", "float64", "float16", "int64", "uint8", "bool", ">f4"])
def test_arrays_come_as_numpy_wrote_them(tmp_path: Path, protocol: int, dtype: str) -> None:
    """Every protocol, both orders of bytes and axes; half precision becomes float32."""
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    made = {
        "c": array,
        "f": np.asfortranarray(array),
        "turned": array.transpose(1, 2, 0),
        "one": array.reshape(-1)[3],
    }

    _, found = read_here(written(tmp_path, made, protocol))

    for name, value in made.items():
        np.testing.assert_array_equal(found[name], value)


def test_tables_and_lists_survive_the_way_between_processes(tmp_path: Path) -> None:
    """What the child writes is what it read: shared values, circles, infinities, records."""
    ring: list[Any] = [1, float("inf"), "text", None, True]
    ring.append(ring)
    content = {"ring": ring, "array": np.arange(3.0), 7: Record("a.B", [1], {"x": 2.5})}

    found = decode(encode(content, tmp_path), tmp_path)

    assert found["ring"][:5] == ring[:5]
    assert found["ring"][5] is found["ring"]
    np.testing.assert_array_equal(found["array"], np.arange(3.0))
    assert found["7" if "7" in found else 7] == Record("a.B", [1], {"x": 2.5})


def test_an_array_of_objects_is_refused(tmp_path: Path) -> None:
    """Objects in an array could be anything."""
    path = written(tmp_path, np.array([{}, []], object))

    with pytest.raises(ValueError, match=r"holds objects|no plain numbers"):
        read_here(path)


@pytest.mark.parametrize("axes", [(0, 0, 1), (0, 1), (0, 1, 3)])
def test_axes_that_are_no_order_are_refused(tmp_path: Path, axes: tuple[int, ...]) -> None:
    """What NumPy does not write is no array."""

    class Turned:
        def __reduce__(self) -> tuple[Any, ...]:
            make = np.zeros(1).__reduce_ex__(5)[0]
            return make, (bytes(24), np.dtype("u1"), (2, 3, 4), "K", axes)

    with pytest.raises(ValueError, match="3 axes has them in the order"):
        read_here(written(tmp_path, Turned()))


def test_an_ordered_table_is_a_table(tmp_path: Path) -> None:
    """As SPADE-pytorch stores its features."""
    _, found = read_here(written(tmp_path, OrderedDict(layer1=np.ones(2), layer2=np.zeros(1))))

    assert list(found) == ["layer1", "layer2"]


def test_a_stand_in_cannot_be_changed() -> None:
    """BUILD with attributes for a stand-in's class or function ends the reading."""
    for target in (b"ccollections\nOrderedDict\n", b"ctorch\nFloatStorage\n"):
        with pytest.raises(Exception, match=r"change|argument|setstate"):
            Unpickler(io.BytesIO(b"\x80\x02" + target + b"}X\x01\x00\x00\x00aK\x01sb.")).load()


def test_globals_are_compared_as_complete_names() -> None:
    """A dotted name of protocol 4 cannot climb out of an allowed package: it stays a name."""
    found = Unpickler(io.BytesIO(b"\x80\x04\x8c\x05timm.\x8c\x02os\x93.")).load()
    assert found.kind == "timm..os"
    with pytest.raises(ForbiddenGlobal):
        Unpickler(io.BytesIO(b"\x80\x04\x8c\x02os\x8c\x06system\x93.")).load()


def test_the_reader_ends_at_its_limit_of_memory(tmp_path: Path) -> None:
    """A small file that wants gigabytes: a sentence, and the caller lives on."""
    bomb = b"\x80\x02" + b"X\xff\xff\xff\x00" + b"a" * 100
    (tmp_path / "bomb.pkl").write_bytes(bomb + b"." * 10)

    with (
        pytest.raises(ConfigError, match=r"bomb\.pkl was not imported: "),
        read_foreign(tmp_path / "bomb.pkl"),
    ):
        pass


def test_the_reader_says_how_it_was_kept_apart(tmp_path: Path) -> None:
    """Own network namespace, or an interpreter that refuses sockets."""
    with read_foreign(written(tmp_path, {"a": 1})) as found:
        assert "without network" in found.isolation or "refuses sockets" in found.isolation
        assert found.content == {"a": 1}


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "of no known kind"),
        (b"plain text", "of no known kind"),
        (b"\x08\x08\x12\x04test", "it is an ONNX model, a finished graph: gelgate bundle wrap takes it"),
        (b"<?xml version='1.0'?><net name='m'>", "it is an OpenVINO model"),
        (b"\x80\x04K\x01", "cannot be read"),
    ],
)
def test_other_files_are_named(tmp_path: Path, content: bytes, sentence: str) -> None:
    """What the file is instead, and what was expected."""
    (tmp_path / "file").write_bytes(content)

    with pytest.raises(ConfigError, match=sentence), read_foreign(tmp_path / "file"):
        pass


def archive(folder: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    path = folder / "model.ckpt"
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return path


def tensor(size: int, stride: int, count: int, offset: int = 0) -> bytes:
    """A pickle of one tensor that views storage 0."""
    return (
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000"
        b"X\x03\x00\x00\x00cpu" + b"J" + struct.pack("<i", count) + b"tQJ" + struct.pack("<i", offset)
        + b"J" + struct.pack("<i", size) + b"\x85J" + struct.pack("<i", stride)
        + b"\x85\x89ccollections\nOrderedDict\n)RtR."
    )  # fmt: skip


def test_a_tensor_of_an_archive_is_its_numbers(tmp_path: Path) -> None:
    """Every second of six."""
    members = {
        "m/data.pkl": tensor(3, 2, 6),
        "m/byteorder": b"little",
        "m/data/0": np.arange(6, dtype="<f4").tobytes(),
    }

    _, found = read_here(archive(tmp_path, members))

    np.testing.assert_array_equal(found, np.array([0, 2, 4], np.float32))


@pytest.mark.parametrize(
    ("members", "compression", "sentence"),
    [
        ({"m/data.pkl": tensor(7, 1, 6), "m/data/0": bytes(24)}, zipfile.ZIP_STORED, "exceeds its storage"),
        ({"m/data.pkl": tensor(3, -1, 6), "m/data/0": bytes(24)}, zipfile.ZIP_STORED, "negative sizes"),
        (
            {"m/data.pkl": tensor(2**20, 0, 6), "m/data/0": bytes(24)},
            zipfile.ZIP_STORED,
            "exceeds its storage",
        ),
        ({"m/data.pkl": tensor(6, 1, 6), "m/data/0": bytes(20)}, zipfile.ZIP_STORED, "cut short"),
        ({"m/data.pkl": tensor(6, 1, 6)}, zipfile.ZIP_STORED, "missing"),
        ({"m/data.pkl": b"N.", "../evil": b""}, zipfile.ZIP_STORED, "leaves the archive's folder"),
        ({"m/data.pkl": b"N.", "/etc/evil": b""}, zipfile.ZIP_STORED, "leaves the archive's folder"),
        ({"m/data.pkl": b"N."}, zipfile.ZIP_DEFLATED, "compressed"),
        ({"m/data.pkl": b"N.", "m/byteorder": b"big"}, zipfile.ZIP_STORED, "other byte order"),
        ({"m/code.py": b""}, zipfile.ZIP_STORED, "without one data.pkl"),
    ],
)
def test_a_wrong_archive_is_refused(
    tmp_path: Path, members: dict[str, bytes], compression: int, sentence: str
) -> None:
    """Nothing is read beyond its bounds, and no member leaves its folder."""
    with pytest.raises(ValueError, match=sentence):
        read_here(archive(tmp_path, members, compression))


def stream(*objects: object) -> bytes:
    """PyTorch's older file: magic number, protocol, platform, and these objects."""
    return b"".join(pickle.dumps(one, protocol=2) for one in (MAGIC, PROTOCOL, {}, *objects))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "Ran out of input"),
        (stream(Call(print, "sprung")), "print, which is not on the list"),
        (stream(OrderedDict())[:-9], "pickle|input"),
        (b"".join(pickle.dumps(n, protocol=2) for n in (1, 2, 3)), "magic number"),
    ],
)
def test_a_wrong_older_file_is_refused(
    content: bytes, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing, a call of a function, a cut file, other numbers; and nothing was called."""
    with pytest.raises((ValueError, EOFError, pickle.UnpicklingError), match=sentence):
        read_stream(io.BytesIO(content))
    assert capsys.readouterr().out == ""


@pytest.mark.train
def test_pytorch_agrees(tmp_path: Path) -> None:
    """Archive, older file, and tensors in a plain pickle: what PyTorch wrote is what is read."""
    import torch

    wide = torch.arange(24, dtype=torch.float32).reshape(4, 6)
    state = {
        "w": wide.T, "half": wide.half(), "bf": wide.bfloat16(), "n": torch.tensor(3),
        "p": torch.nn.Parameter(wide[1:3]), "empty": torch.empty(0), "flag": torch.tensor([True, False]),
    }  # fmt: skip
    torch.save(state, tmp_path / "new.pt")
    torch.save(state, tmp_path / "old.pt", _use_new_zipfile_serialization=False)
    (tmp_path / "plain.pkl").write_bytes(pickle.dumps(state))

    for name in ("new.pt", "old.pt", "plain.pkl"):
        _, found = read_here(tmp_path / name)
        for key, value in state.items():
            np.testing.assert_array_equal(found[key], value.detach().float().numpy(), err_msg=f"{name} {key}")
