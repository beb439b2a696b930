"""Messages of a station as its page gets them, and a client of the page."""

import http.client
import json
from pathlib import Path
from typing import Any

from edge.core.gel_life import GelState
from edge.core.ports import Message
from edge.core.reference_press.charts import ReferencePress, judge
from edge.core.verdict import Kind
from edge.messaging.piece_payloads import PiecePayload, PiecePlace
from edge.messaging.reference_message import describe_reference_press
from edge.messaging.result_payload import PressFiles, ResultPayload, picture_messages
from edge.messaging.status_payloads import (
    ChartPart,
    ContactPayload,
    DriftPayload,
    GelPayload,
    InfoPayload,
    StatePayload,
    StatsPayload,
)
from edge.store.ulid import new_ulid

ROOT = "gelgate/plant/line1/press2/gel/v1"
T0_NS = 1_769_860_800 * 10**9
PICTURE = (Path(__file__).parents[2] / "docs" / "images" / "damaged_press.png").read_bytes()
TOKEN = "correct-horse"


def press(n: int, *, picture: bytes | None = b"\x89PNG\r\n\x1a\n", **outcome: Any) -> list[Message]:
    """Result and picture of press number n, one second after the one before."""
    press_id = new_ulid(T0_NS + n, lambda k: n.to_bytes(k, "big"))
    fields = {"verdict": Kind.PASS, "score": 0.5, "threshold": 1.0, "score_ratio": 0.5, **outcome}
    result = ResultPayload(
        time_ns=T0_NS + n * 10**9,
        press_id=press_id,
        part=fields.pop("part", "bolt"),
        sensor_serial="S",
        gel_id="S-1",
        gel_presses=n,
        gel_limit_presses=1000,
        **fields,
    )
    pictures = [] if picture is None else picture_messages(press_id, PressFiles(picture))
    return [Message("result", result.encode()), *pictures]


def gel(presses: int, state: GelState) -> Message:
    fields = {"sensor_serial": "S", "gel_id": "S-1", "limit_presses": 1000}
    return GelPayload(time_ns=T0_NS, presses=presses, state=state, **fields).message()


def state(word: str, reason: str | None = None) -> Message:
    return StatePayload(time_ns=T0_NS, state=word, reason=reason).message()  # type: ignore[arg-type]


def info(
    part: str = "bolt",
    position: str = "pos1",
    parts: tuple[str, ...] = ("bolt/pos1", "nut/pos1"),
    warnings: tuple[str, ...] = (),
) -> Message:
    return InfoPayload(
        time_ns=T0_NS,
        gelgate_version="0.2.0",
        sensor_product="GelSight Mini R0B",
        sensor_serial="2BNN4ZE7",
        part=part,
        position=position,
        parts=parts,
        method="padim",
        revision=3,
        warnings=warnings,
    ).message()


def piece(
    verdicts: tuple[str | None, ...], piece_id: str | None = "0042", last: tuple[str, str] | None = None
) -> Message:
    """A piece of so many places."""
    names = ("left", "middle", "right")[: len(verdicts)]
    filled = {
        "places": tuple(
            PiecePlace(part="bolt", position=name, verdict=verdict)  # type: ignore[arg-type]
            for name, verdict in zip(names, verdicts, strict=True)
        ),
        "expected": tuple(
            f"bolt/{name}" for name, verdict in zip(names, verdicts, strict=True) if verdict is None
        ),
    }
    last_id, last_verdict = last or (None, None)
    return PiecePayload.model_validate(
        {"time_ns": T0_NS, "piece_id": piece_id, "order": "free", **filled}
        | {"last_id": last_id, "last_verdict": last_verdict}
    ).message()


def drift(shift: int = 0, count: int = 44, what_to_do: str = "check the lamp") -> Message:
    """Two charts: the score, which has not shifted, and the light."""
    fields = {
        "unit": "",
        "count": count,
        "newest": 0.761,
        "mean": 0.75,
        "above": (0.0, 0.4),
        "below": (0.0, 0.0),
    }
    calm = ChartPart(measure="score_ratio", title="score / threshold", shift=0, what_to_do="", **fields)  # type: ignore[arg-type]
    light = calm.model_copy(
        update={
            "measure": "light_levels",
            "title": "light of the free gel",
            "unit": "levels",
            "newest": 98.0,
            "mean": 117.2,
            "below": (2.0, 11.5),
            "shift": shift,
            "what_to_do": what_to_do,
        }
    )
    return DriftPayload(
        time_ns=T0_NS, part="bolt", position="pos1", gel_id="S-1", learnt=20, limit=10.0, charts=(calm, light)
    ).message()


def stats(**receivers: str) -> Message:
    counts = {"uptime_s": 1, "frames": 1, "frames_corrupt": 0, "delivered_fps": 24.9, "presses": 2}
    return StatsPayload(time_ns=1, receivers=receivers, **counts).message()  # type: ignore[arg-type]


def ask(
    port: int,
    path: str,
    method: str = "GET",
    body: bytes | None = None,
    **headers: str | None,
) -> tuple[int, bytes]:
    """The answer of a page on this machine. headers: `_` for `-`; None leaves one out."""
    sent = {"Host": f"127.0.0.1:{port}", **({} if body is None else {"Content-Type": "application/json"})}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}  # type: ignore[misc]
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    if body is not None:
        sent = {"Content-Length": str(len(body)), **sent}
    for name, value in sent.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def asked(port: int, path: str) -> Any:
    """The JSON at a path."""
    return json.loads(ask(port, path)[1])


def reference(**fields: Any) -> Message:
    """The seventh reference press of a master piece, in its limits. fields: of its result."""
    presses = [
        ReferencePress(str(n), 1 + n, "g", "b", "pass", "pass", 0.5 + 0.01 * (n % 3), 1.0) for n in range(7)
    ]
    given = {"sensor_serial": "2BNN4ZE7", "gel_id": "g", "gel_presses": 7, **fields}
    result = ResultPayload(
        time_ns=7,
        press_id="01ARZ3NDEKTSV4RRFFQ69G5FAV",
        part="bolt",
        verdict=Kind.PASS,
        score=0.5,
        threshold=1.0,
        gel_limit_presses=1000,
        **given,
    )
    return describe_reference_press(result, 7, "M1", "pass", judge(presses, 5)).message()


def contact(
    word: str, guidance: str | None = None, direction_deg: float | None = None, ms: int = 0
) -> Message:
    """What is said of the contact, so many milliseconds after the first."""
    return ContactPayload(
        time_ns=T0_NS + ms * 10**6,
        state=word,  # type: ignore[arg-type]
        guidance=guidance,  # type: ignore[arg-type]
        direction_deg=direction_deg,
    ).message()
