"""Whatever is asked of a station, each request is answered, and each press judged, recorded and counted."""

import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from station import press_recording, station_config
from stepped_station import SteppedStation

from edge.gateway.command_table import every_command, station_handlers
from edge.gateway.commands import CommandPolicy, Commands

PRESSES = 6
# The first waits for a loop of another thread; with the other the gel is learnt all the time.
LEFT_OUT = {"self_test", "relearn"}
ODD: list[Any] = [
    None,
    True,
    -1,
    2**63,
    10**400,
    1.5,
    -1e308,
    math.nan,
    math.inf,
    "",
    "ä中",
    "x" * 5000,
    "a\0",
    [],
    [{}],
    {},
]


class Now:
    """The calls of another thread, done at once."""

    def __init__(self, station: SteppedStation) -> None:
        self.ask = lambda do: do(station.loop)


def draw(schema: dict[str, Any], known: dict[str, Any], ids: list[str], rng: random.Random) -> Any:
    """Draw a value that a JSON schema describes, or one that it does not."""
    schema = known[schema["$ref"].rsplit("/")[-1]] if "$ref" in schema else schema
    kinds: dict[str | None, Callable[[], Any]] = {
        "string": lambda: rng.choice(["a", "PZ1", "default", "2026-12-31", *ids]),
        "integer": lambda: rng.choice([0, 1, 1000]),
        "number": lambda: rng.choice([0, 1.5, 5]),
        "boolean": lambda: rng.random() < 0.5,
        "array": lambda: [draw(schema.get("items", {}), known, ids, rng) for _ in range(rng.randrange(4))],
        "object": lambda: {
            name: draw(one, known, ids, rng)
            for name, one in schema.get("properties", {}).items()
            if rng.random() < 0.8
        },
    }
    if "anyOf" in schema:
        return draw(rng.choice(schema["anyOf"]), known, ids, rng)
    if "enum" in schema:
        return rng.choice(schema["enum"])
    kind = schema.get("type")
    return kinds[kind]() if kind in kinds and rng.random() < 0.9 else rng.choice(ODD)


@pytest.mark.parametrize("seed", range(2))
def test_no_request_ends_a_station_or_loses_a_press(tmp_path: Path, bundle: Path, seed: int) -> None:
    """Requests of every verb between the frames, by each verb's schema and beside it."""
    rng, commands = random.Random(seed), [one for one in every_command() if one.verb not in LEFT_OUT]
    recording = press_recording(tmp_path / "presses", PRESSES)
    with SteppedStation(station_config(tmp_path / "station", recording, bundle)) as station:
        handlers = station_handlers(Now(station), commands)  # type: ignore[arg-type]
        policy = CommandPolicy("gelgate/x", frozenset(handlers))
        asked = Commands(handlers, policy, station.parts.store, station.clock, 6000)
        while not station.has_ended:
            station.play(4)
            schema = (one := rng.choice(commands)).arguments.model_json_schema()
            ids = [result.press_id for result in station.results]
            arguments = draw(schema | {"type": "object"}, schema.get("$defs", {}), ids, rng)
            request = {"transaction": str(rng.random()), "arguments": arguments}
            answer = json.loads(asked(one.verb, json.dumps(request).encode()))
            assert "internal error" not in (answer["error"] or ""), request
        counted = sum(gel.presses for gel in station.parts.store.gels())

    assert len(station.results) == counted > 0
    assert not station.loop.is_halted
