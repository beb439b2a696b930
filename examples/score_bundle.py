"""Scores a press with a gelgate bundle: onnxruntime and numpy alone, without gelgate.

    python score_bundle.py BUNDLE            scores the bundle's own golden frames, and compares
    python score_bundle.py BUNDLE press.npy  scores a frame: uint8 (h, w, 3) RGB, cut to the bundle's region

It follows docs/bundle.md. A program of your own may be written the same way in another language.
"""

import hashlib
import io
import json
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import onnxruntime as ort


class BundleFiles:
    """The files of a bundle, a folder or a zip, each checked against its SHA-256 in the manifest."""

    def __init__(self, path):
        self._path, self._zip, self._root = Path(path), None, ""
        if not self._path.is_dir():
            self._zip = zipfile.ZipFile(self._path)
            name = min((n for n in self._zip.namelist() if n.endswith("manifest.json")), key=len)
            self._root = name[: -len("manifest.json")]
        self.manifest = json.loads(self._bytes("manifest.json"))
        if self.manifest["schema_version"] != 1:
            raise SystemExit(
                f"{path}: manifest schema {self.manifest['schema_version']}, this program reads 1"
            )

    def read(self, entry):
        data = self._bytes(entry["file"])
        if hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise SystemExit(
                f"{entry['file']} is not the file that the manifest names; copy the bundle again"
            )
        return data

    def _bytes(self, name):
        return (self._path / name).read_bytes() if self._zip is None else self._zip.read(self._root + name)


def unpacked(files, entry):
    """A bank array as the head reads it. Packing `float16`: halves times 2**exponent; `int8`: steps times a scale."""
    data = np.load(io.BytesIO(files.read(entry["data"])), allow_pickle=False)
    if entry["packing"] == "float16":
        return np.ldexp(data.astype(np.float32), entry["exponent"])
    if entry["packing"] == "int8":
        scale = np.load(io.BytesIO(files.read(entry["scale"])), allow_pickle=False)
        return data * scale[..., None]
    return data


class Detector:
    """A bundle that is ready to score frames, uint8 (h, w, 3) RGB of its region."""

    def __init__(self, path, threads=2):
        self.files = BundleFiles(path)
        manifest = self.files.manifest
        if manifest.get("dots"):
            raise SystemExit(
                f"{path}: the dots of a marker gel are filled before the graphs; this program cannot"
            )
        if manifest.get("registration"):
            raise SystemExit(
                f"{path}: each press is brought to one pose before the graphs; this program cannot, "
                "fit the bundle again with --set register=never"
            )
        region = manifest["region"]
        self.frame = (region["height"], region["width"])
        self.threshold, self.tolerance = manifest["threshold"]["value"], manifest["tolerance"]
        self._trunk, self._bank, self._tiles = None, {}, None
        if manifest["detector"]:
            self._head = self._session(manifest["detector"], threads)
            return
        if not manifest["backbone"]["in_bundle"]:
            raise SystemExit("the bundle was sent without its trunk; put trunk.onnx into it")
        self._trunk = self._session(manifest["backbone"]["trunk"], threads)
        self._head = self._session(manifest["head"], threads)
        self._bank = {name: unpacked(self.files, entry) for name, entry in manifest["bank"].items()}
        self._tiles, self._taps = manifest["grid"]["tiles"], manifest["grid"]["taps"]

    def prepare(self, rgb):
        """A frame as the bundle's presses were learnt: smoothed over 3x3 pixels, where the manifest says so."""
        if not self.files.manifest.get("is_smoothed"):
            return rgb
        wide = np.pad(rgb, ((1, 1), (1, 1), (0, 0)), mode="edge").astype(np.uint16)
        down = wide[:-2] + 2 * wide[1:-1] + wide[2:]
        return ((down[:, :-2] + 2 * down[:, 1:-1] + down[:, 2:] + 8) >> 4).astype(np.uint8)

    def score(self, rgb):
        """(score_map float32 (h, w), score) of a prepared frame: raw, higher is more anomalous."""
        if rgb.dtype != np.uint8 or rgb.shape != (*self.frame, 3):
            raise SystemExit(f"a frame is uint8 {(*self.frame, 3)}, found {rgb.dtype} {rgb.shape}")
        feeds = {"frames": rgb[None]} if self._trunk is None else {**self._features(rgb), **self._bank}
        wanted = {i.name: feeds[i.name] for i in self._head.get_inputs()}
        score_map, score = self._head.run(["score_map", "score"], wanted)
        return score_map[0], float(score[0])

    def verdict(self, score):
        """As the gateway decides: within the tolerance of the threshold a press is unsure."""
        slack = self.tolerance["score"] + self.tolerance["relative"] * abs(score)
        if slack > 0 and abs(score - self.threshold) <= slack:
            return "unsure"
        return "fail" if score > self.threshold else "pass"

    def _features(self, rgb):
        """The taps. With tiles, the trunk runs on one tile after the other, and the maps are put side by side."""
        names = [o.name for o in self._trunk.get_outputs() if o.name in self._taps]
        if self._tiles is None:
            return dict(zip(names, self._trunk.run(names, {"frames": rgb[None]}), strict=True))
        rows, columns, side = self._tiles["rows"], self._tiles["columns"], self._tiles["size"]
        mosaics = {name: np.zeros((1, *self._taps[name]), np.float32) for name in names}
        for r, top in enumerate(rows):
            for c, left in enumerate(columns):
                tile = np.ascontiguousarray(rgb[top : top + side, left : left + side])[None]
                for name, tile_map in zip(names, self._trunk.run(names, {"frames": tile}), strict=True):
                    h, w = tile_map.shape[2:]
                    mosaics[name][:, :, r * h : (r + 1) * h, c * w : (c + 1) * w] = tile_map
        return mosaics

    def _session(self, entry, threads):
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        return ort.InferenceSession(self.files.read(entry), options, providers=["CPUExecutionProvider"])


def read_png(data):
    """uint8 (h, w, 3) RGB from a PNG of 8 bits, three colours, not interlaced, as bundles hold them."""
    at, packed = 8, b""
    while at < len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height = int.from_bytes(body[:4], "big"), int.from_bytes(body[4:8], "big")
            if tuple(body[8:]) != (8, 2, 0, 0, 0):
                raise SystemExit("this picture is no plain PNG of three colours")
        packed += body if kind == b"IDAT" else b""
        at += length + 12
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + 3 * width)
    above, rows = np.zeros(3 * width, int), []
    for filtering, line in zip(lines[:, 0], lines[:, 1:].astype(int), strict=True):
        above = unfiltered(int(filtering), line, above)
        rows.append(above)
    return np.array(rows, np.uint8).reshape(height, width, 3)


def unfiltered(kind, line, above):
    """One line of a PNG. Kinds: 0 none, 1 left, 2 above, 3 their mean, 4 Paeth."""
    if kind == 0:
        return line
    if kind == 2:
        return (line + above) % 256
    out = np.zeros(len(line) + 3, int)
    corner = np.concatenate([np.zeros(3, int), above])
    for k in range(len(line)):
        a, b, c = out[k], above[k], corner[k]
        if kind == 4:
            far = [abs(b - c), abs(a - c), abs(a + b - 2 * c)]
            guess = (a, b, c)[far.index(min(far))]
        else:
            guess = a if kind == 1 else (a + b) // 2
        out[k + 3] = (line[k] + guess) % 256
    return out[3:]


def main(arguments):
    if not arguments:
        raise SystemExit(__doc__)
    detector = Detector(arguments[0])
    for path in arguments[1:]:
        score_map, score = detector.score(detector.prepare(np.load(path, allow_pickle=False)))
        row, column = np.unravel_index(int(score_map.argmax()), score_map.shape)
        print(f"{path}: score {score:.6g}, {detector.verdict(score)}, largest at row {row}, column {column}")
    if len(arguments) == 1:
        for entry in detector.files.manifest["golden"]:
            _, score = detector.score(read_png(detector.files.read(entry["image"])))
            print(f"{entry['what']}: score {score:.6g}, expected {entry['score']:.6g}")


if __name__ == "__main__":
    main(sys.argv[1:])
