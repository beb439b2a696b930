"""The check before the start: every part of a configuration is tried, and all faults are reported together.

Opened parts stay open for the start that follows: a bundle is loaded, hashed and scored once, and a sensor is opened
once.
"""

import contextlib
import logging
import os
import socket
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, timedelta
from functools import partial
from itertools import combinations
from typing import TypeVar

from edge import registry
from edge.config import Config, InspectionTable, PluginTable
from edge.config.feature_tables import PieceTable
from edge.core.errors import ConfigError, DeviceNotFound, GelgateError, SinkUnavailable, StoreError
from edge.core.gel_life import is_past
from edge.core.part_position import PartPosition
from edge.core.piece import check_places
from edge.core.plugins import HasAddress, HasWarnings, TriesLogin
from edge.core.ports import Clock, Device
from edge.gateway.bundle_set import BundleSet, OpenBundle
from edge.gateway.command_table import station_commands
from edge.gateway.commands import policy_of
from edge.gateway.features import Features, load_features
from edge.gateway.opening import BundleOpener, check_mode, device_opener, explain_first, first_part
from edge.model.manifest_facts import licence_sentence
from edge.store import bundles_in_use, gel_ledger
from edge.store.database import SCHEMA_VERSION, open_read_only, quick_check, schema_version

__all__ = ["Finding", "Preflight", "preflight", "try_sink"]

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S = 2.0

READ_WITHIN_S = 2.0
"""A start reads the database so long: years of presses on a slow disk would take minutes."""

T = TypeVar("T")


@dataclass(frozen=True)
class Finding:
    """One part, tried."""

    part: str
    text: str
    """What was found."""
    error: GelgateError | None = None
    """Why the gateway cannot start with it, None if it can."""


class Preflight(contextlib.ExitStack):
    """The findings, in the order in which a start uses the parts, and the open parts. Close it after the start.

    opener: has opened the bundles. bundles: those without a fault, their golden frames scored. open_device: opens the
    sensor that was tried once more; None where it was not tried. device: the open sensor.
    """

    def __init__(self, opener: BundleOpener) -> None:
        super().__init__()
        self.findings: list[Finding] = []
        self.opener = opener
        self.bundles = BundleSet()
        self.open_device: Callable[[], Device] | None = None
        self.device: Device | None = None

    def try_part(self, part: str, attempt: Callable[[], str]) -> None:
        """Record the result of the attempt, or its error."""
        try:
            self.findings.append(Finding(part, attempt()))
        except GelgateError as error:
            self.findings.append(Finding(part, str(error), error))

    def try_features(self, config: Config) -> None:
        """Try what each feature needs; one that fails leaves the others to be tried."""
        features: Features = {}
        with contextlib.suppress(ConfigError):  # a feature that cannot be loaded is a finding of `commands`
            features = load_features(config)
        for name, package in registry.foreign("features").items() if features else ():
            self.findings.append(Finding("feature", f"{name} of {package} takes part in every press"))
        for name, feature in features.items():
            try:
                for part, attempt in feature.attempts(config):
                    self.try_part(part, attempt)
            except GelgateError as error:
                self.findings.append(Finding(name, str(error), error))

    def open_bundles(self, config: Config) -> None:
        """Load, hash and score the golden frames; one finding for each bundle."""
        try:
            opened = self.opener.open(config.inspection)
        except GelgateError as error:
            self.findings.append(Finding("bundle", str(error), error))
            return
        self.bundles = opened.bundles
        self.findings += [
            Finding("bundle", _describe_bundles(bundle)) for bundle in opened.bundles.bundles.values()
        ]
        self.findings += [
            Finding("shadow", f"{_describe_bundles(shadow)}; it decides nothing")
            for shadow in opened.bundles.shadows.values()
        ]
        self.findings += [
            Finding("shadow", f"warning: {fault}; presses are inspected without it")
            for fault in opened.bundles.shadow_faults
        ]
        self.findings += [Finding("bundle", str(error), error) for error in opened.faults.values()]

    def open_sensor(self, config: Config, clock: Clock) -> str:
        """Open the sensor and compare its mode with the bundle's. Errors: DeviceError, BundleMismatch."""
        bundle = next((one.bundle for one in self.bundles.bundles.values()), None)
        _require_sensor(config)
        self.open_device = device_opener(config.device, bundle.profile.controls if bundle else {}, clock)
        self.device = self.open_device()
        self.callback(self.device.close)
        sensor = self.device.identity
        if bundle is not None:
            check_mode(bundle, sensor)
        return f"{sensor.product}, serial {sensor.serial}, {sensor.mode[0]}x{sensor.mode[1]}"


def preflight(config: Config, clock: Clock, *, is_start: bool = True) -> Preflight:
    """Try bundles, sensor, database and receivers, in the order in which a start uses them.

    The database is read only. is_start: keep the list of bundles that were tried; otherwise no file is written, and
    receivers are asked whether they let the station in, which a start finds out by itself.
    A receiver that is away is not a fault: results wait for it in the outbox, and its finding says so.
    """
    tried = config.store.path.with_name(config.store.path.name + ".tried")
    opener = BundleOpener(tried, config.inspection.threads, clock, keeps_trials=is_start)
    opener.newest = lambda part: _describe_store(config, partial(bundles_in_use.revision, part=part))
    opener.taken = lambda part: _describe_store(config, partial(bundles_in_use.read_takeover, part=part))
    checks = Preflight(opener)
    checks.open_bundles(config)
    if behind := _describe_clock(checks.bundles, clock):
        checks.findings.append(Finding("clock", f"warning: {behind}"))
        if is_start:
            log.warning("%s", behind)
    if config.inspection.part is not None and all(finding.error is None for finding in checks.findings):
        selected = _describe_store(config, bundles_in_use.read_selected)
        checks.try_part("part", lambda: _describe_part(config.inspection, checks.bundles, selected))
    if config.piece is not None and checks.bundles.bundles:
        checks.try_part("places", partial(_check_places, config.piece, checks.bundles))
    checks.try_part("sensor", lambda: checks.open_sensor(config, clock))
    checks.try_part("database", partial(_database, config, clock, is_start=is_start))
    checks.try_part("commands", lambda: _commands(config))
    checks.try_part("pictures", lambda: _pictures(config))
    checks.try_features(config)
    try:
        _check_ports(config)
    except ConfigError as error:
        checks.findings.append(Finding("ports", str(error), error))
    for index, sink in enumerate(config.sinks):
        checks.try_part(
            f"sink {sink.plugin}", partial(try_sink, sink, f"sinks.{index}", logs_in=not is_start)
        )
    return checks


def _describe_bundles(one: OpenBundle) -> str:
    bundle, manifest = one.bundle, one.bundle.manifest
    licence = licence_sentence(manifest)
    return (
        f"{one.part}, {manifest.method} ({manifest.mode}), threshold "
        f"{manifest.threshold.value:.4g}; {len(bundle.golden)} golden frames score as at the fit "
        f"(within {one.golden_difference:.1e}); {bundle.signature}{f'; {licence}' if licence else ''}"
    )


def _describe_clock(bundles: BundleSet, clock: Clock) -> str:
    """Say that the clock lies before a bundle was made; empty where it does not, by days and up to a zone."""
    today = date.fromtimestamp(clock.time_ns() / 1e9)
    for one in bundles.bundles.values():
        made = one.bundle.manifest.provenance.created
        with contextlib.suppress(ValueError):
            if date.fromisoformat(made) > today + timedelta(days=1):
                return (
                    f"the clock of this machine says {today}, and bundle {one.part} was made on {made}; set the clock, "
                    "or presses have wrong times"
                )
    return ""


def _describe_part(table: InspectionTable, bundles: BundleSet, selected: PartPosition | None) -> str:
    """Say which part comes first, and what of `inspection.part` does not hold then. Errors: ConfigError."""
    part, why = first_part(table, bundles, selected), explain_first(table, bundles, selected)
    return f"{part}, {why}" if why else str(part)


def _check_places(table: PieceTable, bundles: BundleSet) -> str:
    """Check that each place of the plan has a bundle. Errors: ConfigError."""
    check_places(table.plan, bundles.find_all)
    return f"{len(table.places)} of a piece, in {table.order} order: {', '.join(map(str, table.plan))}"


def _describe_store(config: Config, ask: Callable[[sqlite3.Connection], T]) -> T | None:
    """An answer of the database; None of a new one. One that cannot be read has its own finding."""
    with (
        contextlib.suppress(StoreError),
        open_read_only(config.store.path, "reading it", any_version=True) as connection,
    ):
        return ask(connection)
    return None


def _require_sensor(config: Config) -> None:
    """Find the sensor. Errors: DeviceNotFound."""
    plugin = registry.device(config.device.plugin)
    options = plugin.Options.model_validate(config.device.options)
    discovered = plugin.discover(options)
    if not any(device.identity for device in discovered):
        seen = "; ".join(device.refusal for device in discovered if device.refusal)
        raise DeviceNotFound(
            f"no sensor for device '{config.device.plugin}' is plugged in"
            + (f" ({seen})" if seen else "; check the cable, then `gelgate devices`")
        )


def _database(config: Config, clock: Clock, *, is_start: bool) -> str:
    path, end_ns = config.store.path, clock.monotonic_ns() + round(READ_WITHIN_S * 1e9)
    if not path.parent.is_dir():
        raise ConfigError(f"store.path: the folder {path.parent} does not exist; make it")
    if path.is_dir():
        raise ConfigError(f"store.path: {path} is a folder; name a file")
    for needed in (path, path.parent) if path.exists() else (path.parent,):
        if not os.access(needed, os.W_OK):
            raise StoreError(
                f"database {path}: {needed} cannot be written; give the gateway's user the right to write the file "
                "and its folder"
            )
    if not path.exists():
        return "new"
    words = []
    try:
        damage = quick_check(path, lambda: is_start and clock.monotonic_ns() > end_ns)
    except TimeoutError:
        damage = None
        words.append(f"it was not read whole within {READ_WITHIN_S:g} s; `gelgate db check` does it")
        log.warning("database %s: %s", path, words[0])
    if damage:
        raise StoreError(f"{damage}; move it away with its -wal to keep both for repair; a new one is made")
    with open_read_only(path, "reading the gel ledger", any_version=True) as connection:
        version = schema_version(connection)
        is_readable = version == SCHEMA_VERSION
        known = gel_ledger.history(connection, None, config.gel.warn_fraction) if is_readable else []
        gels = [
            gel_ledger.find_mounted(connection, serial, 1.0) for serial in sorted({g.serial for g in known})
        ]
    words += [
        f"gel {g.gel_id}: {g.presses} of {g.limit_presses} presses"
        + (f", past its use-by date {g.use_by}" if is_past(g.use_by, date.today()) else "")
        for g in gels
        if g is not None
    ]
    if 0 < version < SCHEMA_VERSION:
        words.append(
            f"of version {version}: a start migrates it to version {SCHEMA_VERSION}, after a copy next to it"
        )
    return "; ".join(words) or "new"


def _commands(config: Config) -> str:
    station_commands(config)
    policy = policy_of(config)
    has_page = any(sink.plugin == "page" for sink in config.sinks)
    words = [f"{verb} (unsigned)" for verb in sorted(policy.unsigned)]
    words += [f"{verb} (signed)" for verb in sorted(policy.signed)]
    words += [f"{verb} (page)" for verb in sorted(policy.page)] if has_page else []
    return ", ".join(words) or "none"


def _pictures(config: Config) -> str:
    retained = "the newest one is retained on last/heatmap"
    if not config.keeps_heatmap:
        retained = (
            "none is retained on last/heatmap: Home Assistant, and dashboards and pages that start later, show none "
            "until the next press; station.last_heatmap = true retains it"
        )
    return f"{config.station.heatmap}; {retained}"


def _check_ports(config: Config) -> None:
    """Check that each server of the station has a port of its own. Errors: ConfigError."""
    served: list[tuple[str, str, int | None]] = [("metrics", "127.0.0.1", config.metrics.port)]
    tables: list[tuple[registry.PluginGroup, str, PluginTable]] = [
        ("sinks", f"sinks.{n}.options", sink) for n, sink in enumerate(config.sinks) if sink.plugin == "page"
    ]
    if config.handshake is not None:
        tables.append(("handshakes", "handshake.options", config.handshake))
    for group, key, table in tables:
        options = registry.options(group, table.plugin).model_validate(table.options)
        host = getattr(options, "host", getattr(options, "bind", ""))
        served.append((key, host, getattr(options, "port", None)))
    for (key, host, port), (other, at, same) in combinations(served, 2):
        if port is not None and port == same and (host == at or {host, at} & {"0.0.0.0", "::"}):
            raise ConfigError(f"{key}.port and {other}.port are both {port}; give each its own")


def try_sink(table: PluginTable, key: str, *, logs_in: bool = True) -> str:
    """Say how a sink answers. Errors: ConfigError for an address that does not exist, or files that cannot be used."""
    options = registry.options("sinks", table.plugin).model_validate(table.options)
    warnings = options.warnings() if isinstance(options, HasWarnings) else ()
    return "; warning: ".join([_answers(options, key, logs_in), *warnings])


def _answers(options: object, key: str, logs_in: bool) -> str:
    if not isinstance(options, HasAddress):
        return "needs no connection"
    host, port = options.address()
    later = "results will wait in the outbox"
    try:
        _look_up(host, port)
        with socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S):
            pass
        if logs_in and isinstance(options, TriesLogin):
            return options.try_login()
        return f"{host}:{port} accepts connections"
    except SinkUnavailable as error:
        return f"warning: {error}; {later}"
    except socket.gaierror as error:
        if error.errno == socket.EAI_AGAIN:  # the name server is away, as at the start of a plant
            return f"{host} cannot be looked up now ({error.strerror}); {later}"
        raise ConfigError(
            f"the address '{host}' is not known ({error.strerror}); correct {key}.options.host"
        ) from error
    except UnicodeError as error:
        raise ConfigError(f"'{host}' cannot be the name of a host; correct {key}.options.host") from error
    except OSError as error:
        return f"{host}:{port} does not answer ({error.strerror or error}); {later}"


def _look_up(host: str, port: int) -> None:
    """Look a host up, and wait no longer than for a connection: name servers that are away hold a lookup for minutes.

    Errors: TimeoutError, and those of `socket.getaddrinfo`.
    """
    faults: list[Exception] = []

    def ask() -> None:
        try:
            socket.getaddrinfo(host, port)
        except (OSError, UnicodeError) as error:
            faults.append(error)

    lookup = threading.Thread(target=ask, name="look-up", daemon=True)
    lookup.start()
    lookup.join(CONNECT_TIMEOUT_S)
    if lookup.is_alive():
        raise TimeoutError(f"not looked up in {CONNECT_TIMEOUT_S:.0f} s")
    for fault in faults:
        raise fault
