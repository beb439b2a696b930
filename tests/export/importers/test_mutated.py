"""Mutated files of every importer: each is imported or refused with a sentence, and nothing in it is run.

`make fuzz-importers` tries 2,000; a usual run tries fewer of the same sequence.
"""

import contextlib
import io
import os
import pickle
import random
import resource
import struct
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from anomalib_files import SMALL
from toy_trunk import toy_trunk

from calibration.fitting.trunks import Trunk
from edge.core.errors import ConfigError, GelgateError
from export.importers.contract import Settings, importers
from plugins.detectors.inreach.paper import PAPER_TAPS
from plugins.reading.files import HEADER, read_here
from plugins.reading.foreign import Foreign, Record
from plugins.reading.isolated import BASE_BYTES, read_foreign

TRIED = int(os.environ.get("GELGATE_MUTATED", "180"))


READ_APART = 12


def rows(count: int = 6, width: int = 1024) -> Any:
    return np.random.default_rng(0).random((count, width)).astype(np.float32)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Settings]]:
    """A sound file of each importer, and what is given with it."""
    folder = tmp_path_factory.mktemp("seeds")
    small = {"layer1": (6, 4), "layer2": (8, 8), "layer3": (10, 8)}
    cov = np.stack([np.eye(3) * (1 + k) for k in range(80)], axis=2)
    rng = np.random.default_rng(1)
    fapm = {
        **{f"final_{kind}_core_f": rng.random((49, 3, 4)).astype(np.float32) for kind in ("near", "far")},
        **{f"final_{kind}_core_c": rng.random((49, 3, 5)).astype(np.float32) for kind in ("near", "far")},
        "fn_selector_f": rng.random(49) < 0.3,
        "fn_selector_c": rng.random(49) < 0.3,
    }  # fmt: skip
    thirteen = {tap: (2, 2 ** min(int(tap[5]) + 1, 3)) for tap in PAPER_TAPS}
    contents: dict[str, tuple[Any, dict[str, tuple[int, int]], tuple[int, int]]] = {
        "padim_pickle": ({"mean": rng.random((3, 80)), "cov": cov, "idx": [1, 7, 9]}, small, (32, 40)),
        "spade_features": (
            {"layer1": rng.random((3, 6, 8, 10)), "layer2": rng.random((3, 8, 4, 5))}, small, (32, 40),
        ),
        "fapm_pickle": (fapm, {"layer2": (4, 8), "layer3": (5, 16)}, (224, 224)),
        "inreach_points": ({"nominal_points": rows()}, thirteen, (32, 40)),
        "amazon_patchcore": (
            {"backbone.name": "wideresnet50", "layers_to_extract_from": ["layer2", "layer3"], "patchsize": 3},
            small, (32, 40),
        ),
    }  # fmt: skip
    found: dict[str, tuple[Path, Settings]] = {}
    for name, (content, taps, frame) in contents.items():
        path = folder / f"{name}.pkl"
        path.write_bytes(pickle.dumps(content))
        values = {"is_normalised": False} if name == "spade_features" else {}
        found[name] = path, Settings(frame, 15.77, Trunk("toy", toy_trunk(taps)), values=values)
    head = HEADER.pack(b"IxF2", 1024, 6, 1 << 20, 1 << 20, 1, 1)
    (folder / "nnscorer_search_index.faiss").write_bytes(
        head + struct.pack("<Q", 6 * 1024) + rows().tobytes()
    )
    for file in ("padim.ckpt", "patchcore.pt", "dfm.ckpt", "dfkde.ckpt"):
        found[file] = SMALL / file, Settings((48, 64), 15.77)
    return found


def imported(file: Foreign, settings: Settings) -> bool:
    """Whether an importer makes a model of it. Any error but a sentence fails the test."""
    for one in importers():
        if one.recognised(file) is not None:
            try:
                one.imported(file, settings)
            except GelgateError as error:
                return not _is_sentence(str(error))
            return True
    return False


def _is_sentence(text: str) -> bool:
    assert text
    assert "\n" not in text
    return True


def test_sound_files_are_imported(seeds: dict[str, tuple[Path, Settings]]) -> None:
    """The files that are mutated below are right before."""
    for path, settings in seeds.values():
        assert imported(Foreign(path, *read_here(path)), settings), path


def test_mutated_files_are_sentences(seeds: dict[str, tuple[Path, Settings]], tmp_path: Path) -> None:
    """Bytes and values changed at random: no traceback, no warning, no file of the canary."""
    rng = random.Random(0)
    canary, scratch = tmp_path / "canary", tmp_path / "file"
    made = refused = 0
    for number in range(TRIED):
        path, settings = seeds[rng.choice(list(seeds))]
        original = path.read_bytes()
        try:
            kind = number % 3
            if kind == 0:
                content = read_here(path)
                file = Foreign(path, content[0], changed_value(content[1], rng))
            else:
                data = (
                    changed_bytes(original, rng)
                    if kind == 1
                    else with_canary({"mean": np.zeros(3)}, canary, rng)
                )
                scratch.write_bytes(data)
                with as_little_memory_as_the_reader():
                    file = Foreign(path, *read_here(scratch))
        except Exception:  # noqa: BLE001 (the reader's process turns every error into its sentence)
            refused += 1
            continue
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", RuntimeWarning
            )  # overflow of absurd numbers; the sentence follows
            if imported(file, settings):
                made += 1
            else:
                refused += 1
    assert made + refused == TRIED
    assert refused > TRIED // 2
    assert not canary.exists()


def test_a_byte_that_asks_for_gigabytes_is_refused_here_too(tmp_path: Path) -> None:
    """The number of a memo, 2 to the power of 30, for which a pickle's reader makes room."""
    (tmp_path / "model.pkl").write_bytes(b"\x80\x02Nr\xff\xff\xff\x3f.")

    with pytest.raises(MemoryError), as_little_memory_as_the_reader():
        read_here(tmp_path / "model.pkl")


def _read_or_refused(path: Path) -> None:
    try:
        with read_foreign(path):
            pass
    except ConfigError as error:
        if "model.pkl was not imported: " not in str(error):
            raise


def test_mutated_files_end_in_the_reader(seeds: dict[str, tuple[Path, Settings]], tmp_path: Path) -> None:
    """The same by the process that users' files are read in: a sentence with the file's name, and no canary."""
    rng = random.Random(1)
    canary, scratch = tmp_path / "canary", tmp_path / "model.pkl"
    for number in range(READ_APART):
        path, _ = seeds[rng.choice(list(seeds))]
        is_canary = number % 2 == 0
        data = with_canary([1], canary, rng) if is_canary else changed_bytes(path.read_bytes(), rng)
        scratch.write_bytes(data)
        if is_canary:
            with (
                pytest.raises(ConfigError, match=r"model\.pkl was not imported: it names "),
                read_foreign(scratch),
            ):
                pass
        else:
            _read_or_refused(scratch)
    assert not canary.exists()


_VALUES: list[Any] = [
    None, True, -1, 0, 2**40, float("nan"), "", "text", [], {}, [[]], np.zeros(0), np.zeros((2, 2, 2, 2)),
    np.full(3, np.inf), np.array(7), Record("torch.nn.modules.x.Y", [1], {"a": 1}),
]  # fmt: skip


@contextlib.contextmanager
def as_little_memory_as_the_reader() -> Iterator[None]:
    """What the reader's process may take, on top of what this one has: one byte of a pickle can ask for gigabytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + BASE_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def changed_bytes(data: bytes, rng: random.Random) -> bytes:
    """A file with some bytes changed; in an archive those of its pickle, packed again so that its sum is right."""
    if data[:4] != b"PK\x03\x04" or rng.random() < 0.2:
        return _scrambled(data, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as new:
        for member in old.infolist():
            content = old.read(member)
            name = member.filename
            if name.endswith("data.pkl"):
                content = _scrambled(content, rng)
            elif rng.random() < 0.02:
                name = rng.choice(["../" + name, "/" + name, name + "x", name])
                content = content[: rng.randrange(len(content) + 1)]
            new.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _scrambled(data: bytes, rng: random.Random) -> bytes:
    found = bytearray(data)
    # The beginning of a file decides how it is read.
    reach = len(found) if rng.random() < 0.5 else min(len(found), 2000)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        at = rng.randrange(reach)
        match rng.randrange(4):
            case 0:
                found[at] = rng.randrange(256)
            case 1:
                found[at] ^= 1 << rng.randrange(8)
            case 2:
                del found[at : at + rng.randrange(1, 9)]
            case _:
                found[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 5)))
        reach = max(1, min(reach, len(found)))
    return bytes(found)


def changed_value(content: Any, rng: random.Random, depth: int = 0) -> Any:
    """The same content with one value in it, at any depth, of another kind, size or sign, or missing."""
    if isinstance(content, dict) and content and (depth == 0 or rng.random() < 0.8):
        key = rng.choice(list(content))
        changed = dict(content)
        if rng.random() < 0.15:
            del changed[key]
        else:
            changed[key] = changed_value(content[key], rng, depth + 1)
        return changed
    if isinstance(content, list) and content and rng.random() < 0.7:
        at = rng.randrange(len(content))
        return [*content[:at], changed_value(content[at], rng, depth + 1), *content[at + 1 :]]
    if isinstance(content, Record) and rng.random() < 0.8:
        return Record(content.kind, content.args, changed_value(content.state, rng, depth + 1))
    if isinstance(content, np.ndarray) and content.size and rng.random() < 0.7:
        return _changed_array(content, rng)
    return rng.choice(_VALUES)


def _changed_array(array: Any, rng: random.Random) -> Any:
    match rng.randrange(6):
        case 0:
            return array[1:] if array.ndim else array
        case 1:
            return array.reshape(-1)
        case 2:
            return -array.astype(np.float64)
        case 3:
            return np.where(np.arange(array.size).reshape(array.shape) == 0, np.nan, array.astype(np.float64))
        case 4:
            return array.astype(np.float64) * 1e300
        case _:
            return array.T


class _Call:
    def __init__(self, function: Any, *args: Any) -> None:
        self.reduced = function, args

    def __reduce__(self) -> Any:
        return self.reduced


def with_canary(content: Any, canary: Path, rng: random.Random) -> bytes:
    """A pickle of the content that would also make the file `canary`, if anything in it were run."""
    import os
    import subprocess

    text = f"open({str(canary)!r}, 'w').close()"
    call = rng.choice(
        [_Call(os.system, f"touch {canary}"), _Call(exec, text), _Call(eval, text), _Call(open, str(canary), "w"),
         _Call(subprocess.check_call, ["touch", str(canary)]), _Call(os.mkdir, str(canary)),
         _Call(Path.touch, canary)]
    )  # fmt: skip
    return pickle.dumps(
        [call, content] if rng.random() < 0.5 else {"content": content, "x": call}, rng.randrange(2, 6)
    )
