"""How the configured bundle and sensor are opened, by the check before a start and by the start itself."""

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from importlib.metadata import version

from edge import registry
from edge.config import Config, PluginTable
from edge.core.plugins import PlaysRecording
from edge.core.ports import Clock, Device
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, Bundle
from edge.model.scorer import Scorer
from edge.model.signature import Trust, trusted_keys
from edge.model.trial import try_bundle
from edge.recording.format import Recording

__all__ = ["device_opener", "open_scorer", "overview_opener", "played_recording", "try_once"]


def open_scorer(config: Config) -> tuple[Scorer, float]:
    """The configured bundle, ready to score, and the largest difference of its golden scores.

    Errors: BundleError; ConfigError for the trusted keys.
    """
    inspection = config.inspection
    keys = {} if inspection.trusted_keys is None else trusted_keys(inspection.trusted_keys)
    bundle = Bundle.load(inspection.bundle, trust=Trust(inspection.signed, keys))
    scorer = Scorer(bundle, threads=inspection.threads)
    return scorer, scorer.check_golden()


def try_once(config: Config) -> None:
    """Run the configured bundle in a child process with limits, unless it was: its digest is kept at the database.

    Errors: BundleError.
    """
    path, inspection = config.inspection.bundle, config.inspection
    keys = {} if inspection.trusted_keys is None else trusted_keys(inspection.trusted_keys)
    archive = open_archive(path)
    raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
    Trust(inspection.signed, keys).check(archive, raw)  # before anything of it is run
    mark = (
        f"{hashlib.sha256(raw).hexdigest()} gelgate {version('gelgate')} onnxruntime {version('onnxruntime')}"
    )
    known = config.store.path.with_name(config.store.path.name + ".tried")
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if known.read_text(encoding="utf-8").strip() == mark:
            return
    try_bundle(path, threads=inspection.threads)
    with contextlib.suppress(OSError):  # then it is tried at the next start too
        known.write_text(mark + "\n", encoding="utf-8")


def device_opener(table: PluginTable, controls: Mapping[str, int], clock: Clock) -> Callable[[], Device]:
    """Opens the configured device, the same one each time.

    Camera controls are those of the bundle's sensor profile; the configuration may override some of them.
    """
    plugin = registry.device(table.plugin)
    given = dict(table.options)
    if "controls" in plugin.Options.model_fields:
        given["controls"] = {**controls, **given.get("controls", {})}
    options = plugin.Options.model_validate(given)

    return lambda: plugin.open(options, clock)


def overview_opener(table: PluginTable, clock: Clock) -> Callable[[], Device]:
    """Opens the configured overview camera, the same one each time."""
    plugin = registry.overview(table.plugin)
    options = plugin.Options.model_validate(table.options)
    return lambda: plugin.open(options, clock)


def played_recording(table: PluginTable) -> Recording | None:
    """The recording that the configured device plays; None where it is a sensor. Errors: RecordingError."""
    plugin = registry.device(table.plugin)
    options = plugin.Options.model_validate(table.options)
    return Recording.open(plugin.recording(options)) if isinstance(plugin, PlaysRecording) else None
