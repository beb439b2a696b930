"""Counters for Prometheus, from the messages that the station publishes about itself.

Ref: https://prometheus.io/docs/practices/naming/. Served on the loopback address alone: there is no login. Values are
those of the last report, every `station.stats_s`; `gelgate_report_time_seconds` is its time, so that a station that
hangs is seen.
"""

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import urlsplit

from edge.clock import SystemClock
from edge.config import Config
from edge.core.errors import ConfigError
from edge.core.ports import Message
from edge.extras import needs
from edge.messaging.alarm_payload import list_alarms
from edge.page.access import Access
from edge.page.http_server import HttpHandler, HttpServer
from edge.press_stage import PressStage, StageParts

if TYPE_CHECKING:
    from prometheus_client.core import Metric

__all__ = ["METRICS", "Metrics"]

ADDRESS: Final = "127.0.0.1"

# Field of `stats` to (kind, metric, label of its parts, help). What only rises is a counter.
METRICS: Final[Mapping[str, tuple[str, str, str, str]]] = {
    "uptime_s": ("gauge", "uptime_seconds", "", "time since the start of the process"),
    "frames": ("counter", "frames", "", "frames that the sensor delivered"),
    "frames_corrupt": ("counter", "frames_corrupt", "", "broken frames"),
    "frames_stale": ("counter", "frames_stale", "", "frames that came twice"),
    "frames_dropped": ("counter", "frames_dropped", "", "frames dropped by a machine that is too slow"),
    "frames_late": ("counter", "frames_late", "", "frames processed too late"),
    "delivered_fps": ("gauge", "delivered_fps", "", "frames per second of the sensor"),
    "presses": ("counter", "presses", "", "recorded presses"),
    "presses_interrupted": ("counter", "presses_interrupted", "", "drops while the gel was pressed"),
    "verdicts": ("counter", "verdicts", "verdict", "presses by verdict; error for none"),
    "pieces": ("counter", "pieces", "verdict", "pieces of several places that are over, by verdict"),
    "reconnects": ("counter", "sensor_reconnects", "", "reconnections of the sensor"),
    "latency_ms_p50": ("gauge", "latency_median_milliseconds", "", "rest to verdict, median"),
    "latency_ms_max": ("gauge", "latency_max_milliseconds", "", "rest to verdict, largest"),
    "outbox_rows": ("gauge", "outbox_rows", "", "messages that wait"),
    "outbox_bytes": ("gauge", "outbox_bytes", "", "their size"),
    "outbox_refused": ("gauge", "outbox_refused_rows", "", "messages that a receiver refuses"),
    "dropped": ("counter", "outbox_dropped", "kind", "unsent messages dropped since the database was made"),
    "disk_free_bytes": ("gauge", "disk_free_bytes", "", "room on the disk of the database"),
    "gel_presses": ("gauge", "gel_presses", "", "presses of the mounted gel"),
    "gel_limit_presses": ("gauge", "gel_limit_presses", "", "presses allowed on it"),
    "receivers": ("gauge", "receiver_up", "receiver", "1 where the receiver accepts messages"),
}


class Metrics(PressStage):
    """The newest report of a station, served to this machine alone at /metrics.

    `note` is called by any thread, `collect` by the server's.
    """

    def __init__(self) -> None:
        self._server: HttpServer | None = None
        self._lock = threading.Lock()
        self._stats: dict[str, Any] = {}
        self._state = "starting"
        self._alarms: set[str] = set()

    @classmethod
    def open(cls, parts: StageParts) -> Self | None:
        """Serve what the station says of itself. Errors: ConfigError, as `serve`."""
        if (port := parts.config.metrics.port) is None:
            return None
        metrics = cls()
        metrics.serve(port)
        parts.listen(metrics.note)
        return metrics

    @classmethod
    def attempts(cls, config: Config) -> Iterator[tuple[str, Callable[[], str]]]:
        if config.metrics.port is not None:
            yield "metrics", partial(cls()._try, config.metrics.port)

    def _try(self, port: int) -> str:
        self.serve(port)
        self.close()
        return f"http://{ADDRESS}:{port}/metrics on this machine"

    def note(self, message: Message) -> None:
        """Take a message of the station about itself; others are left out."""
        kind, _, name = message.topic.partition("/")
        with self._lock:
            if kind == "alarm":
                (self._alarms.add if message.payload else self._alarms.discard)(name)
            elif kind == "stats":
                self._stats = json.loads(message.payload)
            elif kind == "state":
                self._state = json.loads(message.payload)["state"]

    def collect(self) -> Iterator["Metric"]:
        """Every metric, as prometheus_client asks for it."""
        with self._lock:
            stats, state, alarms = dict(self._stats), self._state, set(self._alarms)
        yield _family("gauge", "ready", "1 while the station inspects", "", {"": float(state == "ready")})
        raised = {alarm: float(alarm in alarms) for alarm in list_alarms()}
        yield _family("gauge", "alarm", "1 while the alarm is raised", "alarm", raised)
        if stats:
            times_s = {"": stats["time_ns"] / 1e9}
            yield _family(
                "gauge", "report_time_seconds", "when these values were taken, Unix time", "", times_s
            )
        for field, (kind, name, label, text) in METRICS.items():
            if stats.get(field) is not None:
                yield _family(kind, name, text, label, _values(stats[field]))

    def serve(self, port: int) -> None:
        """Answer this machine until `close`. Errors: ConfigError where the extra is missing or the port is taken."""
        needs("metrics", "metrics.port")
        from prometheus_client import CollectorRegistry, ProcessCollector
        from prometheus_client.exposition import choose_encoder

        registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        registry.register(self)

        class Scrape(HttpHandler):
            access = Access()

            def do_GET(self) -> None:
                if urlsplit(self.path).path != "/metrics":
                    self.say(404, "the counters are at /metrics")
                    return
                encode, content_type = choose_encoder(self.headers.get("Accept", ""))
                self.answer(200, content_type, encode(registry))

        try:
            self._server = HttpServer((ADDRESS, port), Scrape, SystemClock(), "metrics")
        except OSError as error:
            raise ConfigError(
                f"metrics.port {port} cannot be served on {ADDRESS}: {error.strerror}; choose another port"
            ) from error
        self._server.start()

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None


def _values(found: object) -> dict[str, float]:
    """Label to value; the label is empty for a number. A receiver is up or it is not."""
    if not isinstance(found, dict):
        return {"": float(found)}  # type: ignore[arg-type]  # a number by the payload's model
    return {
        name: float(value.startswith("up")) if isinstance(value, str) else float(value)
        for name, value in found.items()
    }


def _family(kind: str, name: str, text: str, label: str, values: Mapping[str, float]) -> "Metric":
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    made = CounterMetricFamily if kind == "counter" else GaugeMetricFamily
    family = made(f"gelgate_{name}", text, labels=[label] if label else [])
    for key, value in values.items():
        family.add_metric([key] if label else [], value)
    return family
