"""What `import gelgate` offers. It adds no rule of its own: a score here is the score at a station.

>>> import gelgate
>>> bundle = gelgate.fit("nominal", "bundles/pz1", part="PZ1")
>>> bundle = gelgate.load("bundles/pz1")
>>> press = bundle.score("press.png")
>>> print(press.verdict)
pass
>>> press.value < bundle.threshold
True
>>> bundle.region, press.map.shape
((48, 8, 224, 224), (224, 224))
>>> bundle.score("nowhere.png")
Traceback (most recent call last):
edge.core.errors.DatasetError: nowhere.png: cannot be opened: No such file or directory
"""

from __future__ import annotations

import datetime
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from edge.clock import SystemClock
from edge.core.errors import DatasetError, GelgateError, NotScorable
from edge.core.verdict import Kind

if TYPE_CHECKING:
    from edge.core.contact.mask import Touch
    from edge.gateway.recorder import PressReport
    from edge.gateway.station_loop import StationLoop
    from edge.model.bundle import Bundle as LoadedBundle
    from edge.model.inspector import Inspector

__all__ = ["Bundle", "GelgateError", "Picture", "Score", "fit", "load", "open_station"]

Picture: TypeAlias = str | Path | NDArray[np.uint8]
"""A file as the camera wrote it, or an array uint8 (h, w, 3) RGB of the bundle's `picture_size`."""


@dataclass(frozen=True, eq=False)
class Score:
    """What a bundle says of a picture."""

    verdict: Kind
    """A string: `pass`, `fail`, `unsure` near the threshold, `rejected` where the picture cannot be judged."""
    value: float | None
    """The anomaly score, higher is more anomalous; None where it is rejected."""
    map: NDArray[np.float32] | None
    """Scores of the inspected region, (h, w); None where it is rejected."""
    reason: str = ""
    """Why it is rejected."""


class Bundle:
    """A bundle that scores pictures, as a station does with every press. Made by `load` and `fit`."""

    def __init__(self, loaded: LoadedBundle, threads: int = 2) -> None:
        self._loaded, self._threads = loaded, threads

    @property
    def part(self) -> str:
        """The part that it was fitted to."""
        return self._loaded.manifest.part

    @property
    def position(self) -> str:
        """The place on the part."""
        return self._loaded.manifest.position

    @property
    def method(self) -> str:
        """The detector."""
        return self._loaded.manifest.method

    @property
    def threshold(self) -> float:
        """The largest score that passes."""
        return self._loaded.manifest.threshold.value

    @property
    def picture_size(self) -> tuple[int, int]:
        """(width, height) of a picture that is given as an array."""
        return self._loaded.profile.size

    @property
    def region(self) -> tuple[int, int, int, int]:
        """x, y, width and height of the inspected region in that picture."""
        region = self._loaded.region
        return region.x, region.y, region.width, region.height

    def score(self, picture: Picture) -> Score:
        """Judge a picture of a press.

        Light, sensor and contact are checked as at a station, where the bundle knows them. What a station knows besides
        is not there: the free gel of today, scars, an earlier press of the piece.
        Errors: DatasetError for what is no such picture; NotScorable.
        """
        pixels = self._read(picture)
        press = self._inspector.judge_picture(pixels, self._find_touch(pixels))
        if press.verdict is None:
            raise NotScorable(press.error or "the press has no verdict")
        rejection = press.verdict.rejection
        return Score(
            press.verdict.kind,
            press.verdict.score,
            press.score_map,
            "" if rejection is None else rejection.text,
        )

    @cached_property
    def _inspector(self) -> Inspector:
        from edge.model.inspector import Inspector
        from edge.model.scorer import Scorer

        return Inspector(Scorer(self._loaded, self._threads), SystemClock())

    @cached_property
    def _find_touch(self) -> Callable[[NDArray[np.uint8]], Touch | None]:
        from calibration.fitting.presses.gel_choice import contact_finder
        from edge.core.contact.mask import touched

        if self._loaded.free_view is None:
            return lambda pixels: None
        find = contact_finder([self._loaded.free_view])
        return lambda pixels: touched(find(pixels).mask)

    def _read(self, picture: Picture) -> NDArray[np.uint8]:
        from calibration.dataset.files import read_rgb

        if isinstance(picture, str | Path):
            return read_rgb(Path(picture), self._loaded.profile)
        width, height = self.picture_size
        _check_array(picture)
        if picture.dtype != np.uint8 or picture.shape != (height, width, 3):
            raise DatasetError(
                f"the picture is {picture.dtype} {picture.shape}, expected uint8 ({height}, {width}, 3), RGB, as the "
                f"bundle's profile '{self._loaded.profile.name}' has it; give a file as the camera wrote it instead"
            )
        return picture


def load(path: str | Path, *, threads: int = 2) -> Bundle:
    """Load a bundle, a folder or a zip, and check every file of it. threads: of a score. Errors: BundleError."""
    from edge.model.bundle import Bundle as LoadedBundle

    return Bundle(LoadedBundle.load(path), threads)


def fit(
    pictures: Picture | Sequence[Picture],
    output: str | Path | None = None,
    *,
    part: str = "part",
    position: str | None = None,
    free_gel: Sequence[str | Path] = (),
    **settings: object,
) -> Bundle:
    """Learn a bundle from nominal presses, as `gelgate fit` does.

    pictures: recordings, folders of pictures, datasets, pictures, or arrays uint8 (h, w, 3) RGB. output: where to write
    the bundle, which must not be there; None keeps it in memory. free_gel: pictures of the gel without contact.
    settings: options of `gelgate fit` and names under its `--set` (docs/parameters.md): `method="spade"`, `alpha=0.1`.

    Errors: FitError, DatasetError, RecordingError, ConfigError for a setting.
    """
    from calibration.fitting.command import FitArguments, plan_fit, refuse_existing
    from calibration.fitting.fit import fit_files

    given = [pictures] if isinstance(pictures, str | Path | np.ndarray) else list(pictures)
    options = {field.name for field in fields(FitArguments)} & settings.keys()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "bundle") if output is None else Path(output)
        refuse_existing(target, overwrite=False)
        arguments: dict[str, Any] = {
            "sources": [
                _as_file(picture, Path(folder, f"{number:06d}.png")) for number, picture in enumerate(given)
            ],
            "output": target,
            "part": part,
            "position": position,
            "no_contact": [Path(picture) for picture in free_gel] or None,
            "settings": [f"{name}={json.dumps(settings[name])}" for name in settings.keys() - options],
            **{name: settings[name] for name in options},
        }
        presses, config = plan_fit(FitArguments(**arguments))
        fitted = fit_files(presses, config, created=datetime.date.today().isoformat())
        if output is not None:
            fitted.write(target)
    return Bundle(fitted.bundle(), config.threads)


def _check_array(picture: object) -> None:
    """Errors: DatasetError for what is neither a path nor an array."""
    if not isinstance(picture, np.ndarray):
        kind = type(picture).__name__
        raise DatasetError(f"the picture is of type {kind}, expected a path or an array uint8 (h, w, 3), RGB")


def _as_file(picture: Picture, path: Path) -> Path:
    """Return the path of a picture; an array is written, without loss."""
    if isinstance(picture, str | Path):
        return Path(picture)
    _check_array(picture)
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise DatasetError(f"a picture is {picture.dtype} {picture.shape}, expected uint8 (h, w, 3), RGB")
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes())
    return path


@contextmanager
def open_station(
    config: str | Path, on_press: Callable[[PressReport], None] | None = None
) -> Iterator[StationLoop]:
    """Open the station of a configuration, with its sensor or a recording, and close it. on_press: gets every press.

    >>> import gelgate, threading
    >>> verdicts = []
    >>> with gelgate.open_station("gelgate.toml", lambda press: verdicts.append(str(press.result.verdict))) as station:
    ...     summary = station.run(threading.Event(), presses=2)
    >>> summary.presses, verdicts
    (2, ['pass', 'pass'])

    Errors: ConfigError, BundleError, StoreError.
    """
    from edge.config import load_config
    from edge.gateway.build import open_station as build

    with build(load_config(Path(config)), SystemClock(), on_press or (lambda report: None)) as station:
        yield station
