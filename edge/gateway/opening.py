"""How the configured bundles and sensor are opened: by the check before a start, by the start, and while it runs."""

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from edge import registry
from edge.config import BundleTable, Config, InspectionTable, PluginTable
from edge.core.errors import BundleMismatch, ConfigError, GelgateError, StoreError
from edge.core.part_position import PartPosition
from edge.core.plugins import Played, PlaysRecording
from edge.core.ports import Clock, Device, DeviceIdentity
from edge.extras import find_version
from edge.gateway.bundle_set import BundleSet, OpenBundle, part_of
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import DETECTOR, HEAD, MAX_MANIFEST_BYTES, TRUNK, Bundle
from edge.model.inspector import Inspector
from edge.model.manifest_facts import check_revision
from edge.model.scorer import Scorer
from edge.model.session import TrunkSessions
from edge.model.signature import Trust, trusted_keys
from edge.model.trial import try_bundle

__all__ = [
    "BundleOpener",
    "Opened",
    "bundle_tables",
    "check_mode",
    "device_opener",
    "explain_first",
    "first_part",
    "played_recording",
    "try_once",
]

NewestRevision = Callable[[PartPosition], int | None]

# Keys of [inspection] that a reload reads again.
_RELOADED: Final = {"bundle", "bundles", "bundle_folder", "shadows", "older", "signed", "trusted_keys"}

# Bundles that were tried: more are forgotten, oldest first, and tried again.
KEPT_TRIALS: Final = 256


@dataclass(frozen=True)
class Opened:
    """bundles: those that can be used. faults: why others cannot, each with its path."""

    bundles: BundleSet
    faults: Mapping[Path, GelgateError]
    left: Sequence[str] = ()
    """What of the configuration has changed and is read at a start alone."""


class BundleOpener:
    """Opens bundles: tried in a child process, verified, loaded, run once, golden frames scored.

    tried: the list of bundles that were tried; None runs none in a child process. keeps_trials: add to that list.
    newest: revision of the newest bundle in use for a position. taken: the ids of the configured bundle of a position
    and of the shadow that has taken its place; None where none has. One thread uses it at a time.
    """

    def __init__(self, tried: Path | None, threads: int, clock: Clock, *, keeps_trials: bool = True) -> None:
        self.trunks = TrunkSessions(threads)
        self.newest: NewestRevision = lambda part: None
        self.taken: Callable[[PartPosition], tuple[str, str] | None] = lambda part: None
        self._tried = tried
        self._keeps_trials = keeps_trials
        self._clock = clock

    def open(self, table: InspectionTable, before: BundleSet | None = None) -> Opened:
        """Every bundle of the table. A bundle of `before` is kept where it has not changed and its golden frames
        scored well, and where the new one at its path has a fault.

        Errors: ConfigError for the trusted keys, and for a folder without a bundle.
        """
        before, bundle_set, faults = before or BundleSet(), BundleSet(), dict[Path, GelgateError]()
        trust = Trust(table.signed, {} if table.trusted_keys is None else trusted_keys(table.trusted_keys))
        for bundle_table in bundle_tables(table):
            earlier = before.at(bundle_table.path)
            try:
                bundle_set = bundle_set.with_one(self._open_one(bundle_table, table, trust, earlier))
            except GelgateError as error:
                faults[bundle_table.path] = error
                with contextlib.suppress(GelgateError):
                    bundle_set = (
                        bundle_set.with_one(earlier)
                        if earlier and before.may_inspect(earlier)
                        else bundle_set
                    )
        bundle_set = self._open_shadows(table, trust, before, bundle_set, faults)
        used = [
            bundle.bundle.trunk_sha256
            for each in (before, bundle_set)
            for bundle in (*each.bundles.values(), *each.shadows.values())
        ]
        self.trunks.keep_only(used)
        return Opened(bundle_set, faults)

    def open_again(self, at_start: Config, now: Config, before: BundleSet) -> Opened:
        """The same with what is configured now, and what else has changed since the start. Errors: as `open`."""
        return replace(self.open(now.inspection, before), left=_find_left(at_start, now))

    def _open_shadows(
        self,
        table: InspectionTable,
        trust: Trust,
        before: BundleSet,
        found: BundleSet,
        of_bundles: dict[Path, GelgateError],
    ) -> BundleSet:
        """Open the shadows beside these bundles, each of which inspects whatever becomes of its shadow; one that has
        taken over goes on in its place. of_bundles: takes the fault of one that inspects."""
        faults: list[str] = []
        for path in table.shadows:
            earlier = before.at(path)
            try:
                found = found.with_shadow(self._open_one(BundleTable(path=path), table, trust, earlier))
            except StoreError:  # no fault of the shadow: all are opened again
                raise
            except GelgateError as error:
                if earlier is None or earlier.instead_of is None:
                    faults.append(str(error))
                    continue
                of_bundles[path] = error  # it inspects, and goes on as every bundle in use
                with contextlib.suppress(GelgateError):
                    found = found.with_shadow(replace(earlier, instead_of=None))
        for part, open_bundle in found.bundles.items():
            configured, shadow_id = self.taken(part) or ("", "")
            if open_bundle.bundle.digest != configured:
                continue
            if part in found.shadows and found.shadows[part].bundle.digest == shadow_id:
                found = found.exchange(part)
            else:
                faults.append(
                    f"bundle {shadow_id[:12]}, which had taken the place of {open_bundle.path}, is not among the "
                    f"shadows that can be used, so the configured one inspects {part} again"
                )
        return replace(found, shadow_faults=tuple(faults))

    def _open_one(
        self,
        one: BundleTable,
        table: InspectionTable,
        trust: Trust,
        earlier: OpenBundle | None,
    ) -> OpenBundle:
        """Open one bundle, or take the one that is open and has not changed. Errors: BundleError."""
        is_sound = earlier is not None and earlier.inspector.fault is None
        if earlier is not None and is_sound and _digest(one.path, trust) == earlier.bundle.digest:
            # A graph that has changed under its manifest is refused, as at a start; so is a shadow that grew old.
            self._check_age(Bundle.load(one.path, trust=trust), table)
            return OpenBundle(one.path, one.names, earlier.inspector, earlier.golden_difference)
        if self._tried is not None:
            try_once(one.path, trust, table.threads, self._tried, keep=self._keeps_trials)
        bundle = Bundle.load(one.path, loaded=self.trunks, trust=trust)
        self._check_age(bundle, table)
        scorer = Scorer(bundle, table.threads, self.trunks)
        return OpenBundle(one.path, one.names, Inspector(scorer, self._clock), scorer.check_golden())

    def _check_age(self, bundle: Bundle, table: InspectionTable) -> None:
        """Refuse one that is older than what was in use, unless it is the way back from a shadow that took over."""
        configured, _ = self.taken(part_of(bundle)) or ("", "")
        if table.older == "refused" and bundle.digest != configured:
            check_revision(bundle.manifest, self.newest(part_of(bundle)), bundle.where)


def _find_left(before: Config, now: Config) -> list[str]:
    """Return what differs and is left as it is at a reload, which reads the bundles alone."""
    tables = [name for name in Config.model_fields if name != "inspection"]
    keys = [name for name in InspectionTable.model_fields if name not in _RELOADED]
    return [
        *(name for name in tables if getattr(before, name) != getattr(now, name)),
        *(
            f"inspection.{name}"
            for name in keys
            if getattr(before.inspection, name) != getattr(now.inspection, name)
        ),
    ]


def bundle_tables(table: InspectionTable) -> tuple[BundleTable, ...]:
    """The bundles of a configuration, however they are named. Errors: ConfigError for a folder without a bundle."""
    if table.bundle is not None:
        return (BundleTable(path=table.bundle),)
    if table.bundle_folder is None:
        return table.bundles
    tables = tuple(BundleTable(path=path) for path in _bundles_in(table.bundle_folder))
    if not tables:
        raise ConfigError(
            f"inspection.bundle_folder: there is no bundle in {table.bundle_folder}; `gelgate fit` makes one"
        )
    return tables


def first_part(table: InspectionTable, bundles: BundleSet, selected: PartPosition | None) -> PartPosition:
    """The part that was selected last, or that of the configuration. Errors: ConfigError."""
    if selected is not None and selected in bundles:
        return selected
    if table.part is None:
        return next(iter(bundles.bundles))
    try:
        return bundles.find_by_name(table.part)
    except ValueError as error:
        raise ConfigError(f"inspection.part: {error}") from error


def explain_first(table: InspectionTable, bundles: BundleSet, selected: PartPosition | None) -> str:
    """Say why `first_part` is not what was selected last, or not that of the configuration; empty where it is both."""
    if selected is None:
        return ""
    if selected not in bundles:
        return f"{selected}, selected last, has no bundle here any more"
    try:
        named = first_part(table, bundles, None)
    except ConfigError as error:
        return f"selected last; {error}"
    is_named = table.part is None or named == selected
    return "" if is_named else f"selected last; inspection.part, {named}, is a new station's"


def _bundles_in(folder: Path) -> Iterator[Path]:
    """Names that begin with a dot are bundles that are being written. A graph without a manifest is one that is being
    copied: it is a fault, or its part would be missing without a word."""
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise ConfigError(
            f"inspection.bundle_folder: {folder} cannot be read ({error.strerror}); name a folder of bundles"
        ) from error
    for path in paths:
        is_bundle = path.suffix == ".zip" or any(
            (path / name).exists() for name in (MANIFEST, TRUNK, HEAD, DETECTOR)
        )
        if not is_bundle or path.name.startswith("."):
            continue
        if path.name.encode(errors="ignore").decode() != path.name:  # it stands in messages and rows
            raise ConfigError(
                f"inspection.bundle_folder: the name {path.name!r} in {folder} is not UTF-8; rename this bundle"
            )
        yield path


def _digest(path: Path, trust: Trust) -> str:
    """The identity of the bundle that is there now. Errors: BundleError, also where it is not trusted any more."""
    archive = open_archive(path)
    raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
    trust.check(archive, raw)
    return hashlib.sha256(raw).hexdigest()


def try_once(path: Path, trust: Trust, threads: int, tried: Path, *, keep: bool = True) -> None:
    """Run the bundle in a child process with limits, unless it was: the file `tried` has the digests of those.

    keep: add it there. Errors: BundleError.
    """
    digest = _digest(path, trust)  # the signature before anything of it is run
    mark = f"{digest} gelgate {find_version('gelgate')} onnxruntime {find_version('onnxruntime')}"
    known: list[str] = []
    with contextlib.suppress(OSError, UnicodeDecodeError):
        known = tried.read_text(encoding="utf-8").splitlines()
    if mark in known:
        return
    try_bundle(path, threads=threads)
    if not keep:
        return
    with contextlib.suppress(OSError):  # then it is tried at the next start too
        tried.write_text("\n".join([*known, mark][-KEPT_TRIALS:]) + "\n", encoding="utf-8")


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


def check_mode(bundle: Bundle, sensor: DeviceIdentity) -> None:
    """Check that a sensor sends what a bundle was made from. Errors: BundleMismatch."""
    (w, h), (found_w, found_h) = bundle.profile.native, sensor.mode
    if sensor.mode != bundle.profile.native:
        raise BundleMismatch(
            f"bundle {bundle.where} was made from {w}x{h} frames (profile {bundle.profile.name}), sensor "
            f"{sensor.serial} sends {found_w}x{found_h}; use a bundle made for this sensor's mode"
        )


def played_recording(table: PluginTable) -> Played | None:
    """The recording that the configured device plays; None where it is a sensor. Errors: RecordingError; ConfigError
    for a plugin whose recording cannot be compared."""
    plugin = registry.device(table.plugin)
    options = plugin.Options.model_validate(table.options)
    if not isinstance(plugin, PlaysRecording):
        return None
    played: object = plugin.recording(options)
    if not isinstance(played, Played):
        raise ConfigError(
            f"the device plugin '{table.plugin}' gives a {type(played).__name__} as its recording, expected an object "
            "with check_presses; correct its package"
        )
    return played
