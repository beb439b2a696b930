"""PaDiM of the widely used port, and of the seed paper's public scripts: pickles of mean, covariance and channels.

Ref: xiahaifeng1995/PaDiM-Anomaly-Detection-Localization-master @616004b (a list of mean (d, places) and covariance
(d, d, places); the channels are Python's `random.seed(1024)` and `sample(range(1792), 550)` and are not stored), and
the seed paper's scripts, which store the channels too.
"""

import random
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.errors import ConfigError
from export.importers.contract import Imported, Recognised, Settings, require
from export.importers.heads import Framing, MapSteps
from export.importers.padim_parts import Gaussians, padim_parts
from plugins.reading.foreign import Foreign, check_array

__all__ = ["draw_channels", "padim_pickle"]

LAYERS = ("layer1", "layer2", "layer3")
SIGMA_PX = 4.0
PORT_SEED = 1024
MEANS = ("mean", "means", "mu")
COVARIANCES = ("cov", "covariance", "covariances")
CHANNELS = ("idx", "index", "selected_idx", "selected_index", "channels")


class PadimPickle:
    """The importer under `gelgate.importers`."""

    name = "padim_pickle"

    def recognised(self, file: Foreign) -> Recognised | None:
        """Say what the file is, None for other files."""
        parts = _parts(file)
        if parts is None:
            return None
        mean, cov, index = parts
        stored = "stored" if index is not None else "not stored: those of the port's seed, or --channels FILE"
        fields = {"mean": str(np.shape(mean)), "covariance": str(np.shape(cov)), "channels": stored}
        return Recognised(f"PaDiM's mean and covariance ({file.form})", fields, ("--backbone",))

    def imported(self, file: Foreign, settings: Settings) -> Imported:
        """The parts of a bundle. Settings: `layers`, `ridge_again`. Errors: as `Importer`."""
        parts = require(_parts(file), file, "mean and covariance of PaDiM")
        mean = check_array(file.path, "mean", parts[0], None, None)
        cov = check_array(file.path, "covariance", parts[1], None, None, None)
        d, places = mean.shape
        dense = _dense(file.path, cov, d, places, _ridge_again(file.path, settings))
        layers = tuple(settings.value("layers", tuple, LAYERS))
        trunk, grid = settings.cut_trunk(file.path, layers, "means and covariances alone")
        total = sum(grid.taps[tap][0] for tap in layers)
        channels, words = _channels(file.path, parts[2], settings, d, total)
        gaussians = Gaussians(file.path, "covariance", layers, channels, mean.T, dense, is_inverse=False)
        steps = MapSteps(Framing(settings.frame), SIGMA_PX)
        made = padim_parts(gaussians, grid, steps, settings)
        again = "the seed paper's scripts add the ridge of 0.01 a second time at prediction: --set ridge_again=0.01"
        return Imported(
            method="padim",
            source="PaDiM's mean and covariance",
            trunk=trunk,
            head=made.head,
            bank=made.bank,
            grid=grid,
            parameters={"layers": list(layers), "sigma_px": SIGMA_PX, "channels": int(d)},
            facts=made.facts,
            says=(words, made.reduction.words(), *(() if "ridge_again" in settings.values else (again,))),
            exact=made.exact,
        )


padim_pickle = PadimPickle()


def _parts(file: Foreign) -> tuple[Any, Any, Any] | None:
    """Mean, covariance and channels or None, of a list or a table."""
    content, table = file.content, file.table()
    if isinstance(content, list) and len(content) in (2, 3):
        parts = (*content, None)[:3]
    else:
        parts = tuple(
            next((table[name] for name in names if name in table), None)
            for names in (MEANS, COVARIANCES, CHANNELS)
        )
    mean, cov = parts[:2]
    is_padim = (
        isinstance(mean, np.ndarray) and isinstance(cov, np.ndarray) and mean.ndim == 2 and cov.ndim == 3
    )
    return (parts[0], parts[1], parts[2]) if is_padim else None


def _dense(path: Path, cov: NDArray[Any], d: int, places: int, again: float) -> Any:
    """Gives covariances (m, d, d) of a slice of places, from either order of the axes."""
    if cov.shape not in ((d, d, places), (places, d, d)):
        raise ConfigError(
            f"{path}: 'covariance' is {cov.shape}, ({d}, {d}, {places}) or ({places}, {d}, {d}) was expected by 'mean'"
        )
    is_last = cov.shape == (d, d, places)
    ridge = again * np.eye(d)

    def dense(part: slice) -> NDArray[Any]:
        matrices = cov[:, :, part].transpose(2, 0, 1) if is_last else cov[part]
        return np.asarray(matrices, np.float64) + ridge

    return dense


def _ridge_again(path: Path, settings: Settings) -> float:
    again = float(settings.value("ridge_again", float, 0.0))
    if not 0 <= again < 1e6:
        raise ConfigError(
            f"{path}: --set ridge_again={again} is no ridge; 0.01 is that of the seed paper's scripts"
        )
    return again


def draw_channels(total: int, count: int) -> NDArray[np.int64]:
    """Draw channels as the port does: Python's `sample(range(total), count)` after `seed(1024)`."""
    return np.array(random.Random(PORT_SEED).sample(range(total), count), np.int64)


def _channels(
    path: Path, stored: Any, settings: Settings, count: int, total: int
) -> tuple[NDArray[np.int64], str]:
    given = settings.values.get("channels")
    if given is not None:
        return check_array(path, "channels", given, count).astype(np.int64), "channels as given"
    if stored is not None:
        return check_array(path, "channels", stored, count).astype(np.int64), "channels as stored"
    if count > total:
        raise ConfigError(
            f"{path}: 'mean' has {count} channels, the taps have {total}; name the trunk of the training"
        )
    return draw_channels(total, count), (
        f"the file does not store its channels: taken are the port's, random.seed({PORT_SEED}) and "
        f"sample(range({total}), {count}); other ones by --channels FILE"
    )
