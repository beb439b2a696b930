"""What can be known before the start: every part of a configuration is tried, and everything wrong is told at once."""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from edge import registry
from edge.clock import SystemClock
from edge.config import Config, PluginTable
from edge.core.errors import BundleMismatch, ConfigError, DeviceNotFound, GelgateError
from edge.core.plugins import HasAddress
from edge.model.bundle import Bundle
from edge.model.scorer import Scorer
from edge.store.press_store import Store

__all__ = ["Finding", "preflight"]

CONNECT_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class Finding:
    """One part, tried. error: why the gateway cannot start with it, None if it can. text: what was found."""

    part: str
    text: str
    error: GelgateError | None = None


def preflight(config: Config) -> list[Finding]:
    """Try bundle, sensor, database and receivers, in the order in which a start uses them.

    A receiver that is away is no fault: results wait for it in the outbox; its finding says so.
    """
    return [
        _tried("bundle", lambda: _bundle(config)),
        _tried("sensor", lambda: _sensor(config)),
        _tried("database", lambda: _database(config)),
        *(
            _tried(f"sink {sink.plugin}", partial(_reachable, sink, f"sinks.{index}"))
            for index, sink in enumerate(config.sinks)
        ),
    ]


def _tried(part: str, attempt: Callable[[], str]) -> Finding:
    try:
        return Finding(part, attempt())
    except GelgateError as error:
        return Finding(part, str(error), error)


def _bundle(config: Config) -> str:
    bundle = Bundle.load(config.inspection.bundle)
    scorer = Scorer(bundle, threads=config.inspection.threads)
    worst = scorer.check_golden()
    manifest = bundle.manifest
    return (
        f"{manifest.part}/{manifest.position}, {manifest.method} ({manifest.mode}), threshold "
        f"{manifest.threshold.value:.4g}; {len(bundle.golden)} golden frames score as at the fit (within {worst:.1e})"
    )


def _sensor(config: Config) -> str:
    plugin = registry.device(config.device.plugin)
    options = plugin.Options.model_validate(config.device.options)
    sightings = plugin.survey(options)
    if not any(one.identity for one in sightings):
        seen = "; ".join(one.refusal for one in sightings if one.refusal)
        raise DeviceNotFound(
            f"no sensor for device '{config.device.plugin}' is plugged in"
            + (f" ({seen})" if seen else "; check the cable, then `gelgate devices`")
        )
    # Found is not enough: another process may hold it.
    device = plugin.open(options, SystemClock())
    sensor = device.identity
    device.close()
    native = Bundle.load(config.inspection.bundle).profile.native
    if sensor.mode != native:
        raise BundleMismatch(
            f"sensor {sensor.serial} sends {sensor.mode[0]}x{sensor.mode[1]} frames, the bundle was made from "
            f"{native[0]}x{native[1]}; use a bundle made for this sensor's mode"
        )
    return f"{sensor.product}, serial {sensor.serial}, {sensor.mode[0]}x{sensor.mode[1]}"


def _database(config: Config) -> str:
    if not config.store.path.parent.is_dir():
        raise ConfigError(f"store.path: the folder {config.store.path.parent} does not exist; make it")
    with Store(config.store.path) as store:
        store.check()
        gels = [gel for gel in store.gels() if gel.removed_ns is None]
    return "; ".join(f"gel {g.gel_id}: {g.presses} of {g.limit_presses} presses" for g in gels) or "new"


def _reachable(table: PluginTable, key: str) -> str:
    """Errors: ConfigError for an address that does not exist, or files that cannot be used."""
    options = registry.options("sinks", table.plugin).model_validate(table.options)
    if not isinstance(options, HasAddress):
        return "needs no connection"
    host, port = options.address()
    later = "results will wait in the outbox"
    try:
        with socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S):
            return f"{host}:{port} accepts connections"
    except socket.gaierror as error:
        if error.errno == socket.EAI_AGAIN:  # the name server is away, as it is while a plant comes up
            return f"{host} cannot be looked up now ({error.strerror}); {later}"
        raise ConfigError(
            f"the address '{host}' is not known ({error.strerror}); correct {key}.options.host"
        ) from error
    except UnicodeError as error:
        raise ConfigError(f"'{host}' cannot be the name of a host; correct {key}.options.host") from error
    except OSError as error:
        return f"{host}:{port} does not answer ({error.strerror or error}); {later}"
