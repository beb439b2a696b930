"""A station as a device of Home Assistant: its MQTT discovery message, which names topics and nothing else.

Home Assistant only reads: it can ask the station for nothing.
Ref: home-assistant.io, MQTT integration, "Device discovery payload" (since 2024.12).
"""

from typing import Any, Final

from edge.core.gel import GelState
from edge.core.gel_scars.causes import Cause
from edge.core.verdict import Kind
from edge.messaging.descriptions.station import DescribedStation

__all__ = ["DISCOVERY_PREFIX", "discovery", "discovery_topic"]

DISCOVERY_PREFIX: Final = "homeassistant"

# Of `state`, not of `availability`: a broker may not allow the second connection that this needs.
_AVAILABLE: Final = "{{ 'offline' if value_json.state in ('stopped', 'lost') else 'online' }}"

_DIAGNOSTIC: Final = {"entity_category": "diagnostic"}


def discovery_topic(station: DescribedStation, prefix: str = DISCOVERY_PREFIX) -> str:
    """The topic on which the message is retained; an empty message there removes the device."""
    return f"{prefix}/device/{station.id}/config"


def discovery(station: DescribedStation) -> dict[str, Any]:
    """The message, plain JSON."""
    return {
        "device": {
            "identifiers": [station.id],
            "name": station.place,
            "manufacturer": "gelgate",
            "model": "touch inspection station",
            "sw_version": station.version,
        },
        "origin": {"name": "gelgate", "sw_version": station.version},
        "availability_topic": f"{station.root}/state",
        "availability_template": _AVAILABLE,
        "qos": 1,
        "components": {
            name: {"unique_id": f"{station.id}_{name}", **one}
            for name, one in _components(station.root).items()
        },
    }


def _components(root: str) -> dict[str, dict[str, Any]]:
    press, gel, stats = f"{root}/last/press", f"{root}/gel", f"{root}/stats"
    verdicts = [kind.value for kind in Kind]
    return {
        "verdict": {
            **_sensor("Verdict", press, "value_json.verdict or 'error'"),
            **_words(*verdicts, "error"),
            "json_attributes_topic": press,
        },
        "failed": _problem("Last press not passed", press, "value_json.verdict != 'pass'"),
        "picture": {
            "platform": "image",
            "name": "Last press",
            "image_topic": f"{root}/last/heatmap",
            "content_type": "image/png",
        },
        "score_ratio": _as_measurement(_sensor("Score / threshold", press, "value_json.score_ratio")),
        "cause": {
            **_sensor("Cause", press, "value_json.cause or 'none'"),
            **_words(*(cause.value for cause in Cause), "none"),
        },
        "blind_share": _as_measurement(
            _sensor("Contact under scars of the gel", press, "value_json.blind_share")
        ),
        "time": {**_sensor("Time of the last press", press, "value_json.time"), "device_class": "timestamp"},
        "state": {
            **_sensor("State", f"{root}/state", "value_json.state"),
            **_words("starting", "ready", "halted", "stopped", "lost"),
            "json_attributes_topic": f"{root}/state",
        },
        "alarm": {
            **_problem("Alarm", stats, "value_json.alarms"),
            "json_attributes_topic": stats,
            "json_attributes_template": "{{ {'alarms': value_json.alarms} | tojson }}",
        },
        "gel_state": {
            **_sensor("Gel", gel, "value_json.state"),
            **_words(*(state.value for state in GelState)),
        },
        "gel_presses": {
            **_sensor("Presses on this gel", gel, "value_json.presses"),
            "state_class": "total_increasing",
        },
        "gel_left": _as_measurement(
            _sensor(
                "Presses left on this gel", gel, "[0, value_json.limit_presses - value_json.presses] | max"
            )
        ),
        "latency": {
            **_as_measurement(_sensor("Frame to verdict, median", stats, "value_json.latency_ms_p50")),
            **_DIAGNOSTIC,
            "device_class": "duration",
            "unit_of_measurement": "ms",
        },
        "unsent": {
            **_as_measurement(_sensor("Unsent messages", stats, "value_json.outbox_rows")),
            **_DIAGNOSTIC,
        },
    }


def _sensor(name: str, topic: str, value: str) -> dict[str, Any]:
    return {"platform": "sensor", "name": name, "state_topic": topic, "value_template": f"{{{{ {value} }}}}"}


def _problem(name: str, topic: str, condition: str) -> dict[str, Any]:
    return {
        "platform": "binary_sensor",
        "name": name,
        "state_topic": topic,
        "value_template": f"{{{{ 'ON' if {condition} else 'OFF' }}}}",
        "device_class": "problem",
    }


def _words(*words: str) -> dict[str, Any]:
    return {"device_class": "enum", "options": list(words)}


def _as_measurement(sensor: dict[str, Any]) -> dict[str, Any]:
    return {**sensor, "state_class": "measurement"}
