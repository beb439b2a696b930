"""A flow for Node-RED: a page with the last press, made of the nodes that every Node-RED has.

Imported (menu, Import) and deployed, it shows verdict, picture, gel and state at `/gelgate/` of the Node-RED server.
Ref: nodered.org, "Storing flows"; mqtt in, template and http nodes of Node-RED 3 to 5.
"""

import hashlib
import html
from typing import Any, Final
from urllib.parse import quote

from edge.messaging.descriptions.station import DescribedStation

__all__ = ["PAGE", "flow"]

PAGE: Final = "/gelgate/{place}"
"""The path of the page at the Node-RED server."""

_KEEP_JSON: Final = """\
if (msg.payload === "") { return null; }
flow.set(msg.topic.split("/gel/v1/")[1], msg.payload);
return msg;"""

_KEEP_PICTURE: Final = 'flow.set("picture", msg.payload.length ? msg.payload : undefined);\nreturn null;'

_READ: Final = """\
const press = flow.get("last/press") || {}, gel = flow.get("gel") || {}, state = flow.get("state") || {};
const score = press.score_ratio;
let digits = 2;
while (typeof score === "number" && score !== 1 && Number(score.toFixed(digits)) === 1 && digits < 17) { digits += 1; }
const ratio = typeof score === "number" ? score.toFixed(digits) : "";
msg.payload = {
    verdict: press.press_id ? press.verdict || "error" : "no press yet",
    part: press.part, position: press.position, ratio: ratio, time: press.time, why: press.reason || press.error,
    presses: gel.presses, limit: gel.limit_presses, gel: gel.state, state: state.state, reason: state.reason,
    availability: flow.get("availability"),
};
return msg;"""

_GIVE_PICTURE: Final = """\
msg.payload = flow.get("picture");
msg.statusCode = msg.payload ? 200 : 404;
msg.headers = { "Content-Type": "image/png", "Cache-Control": "no-store" };
msg.payload = msg.payload || "";
return msg;"""

_HTML: Final = """\
<!doctype html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="2">
<meta name="viewport" content="width=device-width">
<title>%(place)s</title>
<style>
body { font: 1.2rem sans-serif; margin: 1rem }
h1 { font-size: 4rem; margin: .2em 0; text-transform: uppercase }
.pass { color: #14783a } .fail, .error { color: #b9191e } .unsure, .rejected { color: #8a5300 }
img { max-width: 100%% }
</style>
<p>%(place)s &middot; {{payload.availability}} &middot; {{payload.state}} {{payload.reason}}</p>
<h1 class="{{payload.verdict}}">{{payload.verdict}}</h1>
<p>{{payload.part}} {{payload.position}} &middot; {{payload.ratio}} &times; threshold &middot; {{payload.time}}</p>
<p>{{payload.why}}</p>
<img src="%(page)s/picture.png" alt="">
<p>gel {{payload.gel}}: {{payload.presses}} of {{payload.limit}} presses</p>
"""


def flow(
    station: DescribedStation, host: str = "localhost", port: int = 1883, *, has_tls: bool = False
) -> list[dict[str, Any]]:
    """The nodes of the flow, plain JSON to import. host, port, has_tls: of the broker; user, password and certificates
    are set in Node-RED."""
    page = PAGE.format(place=quote(station.place))
    page_html = _HTML % {"place": html.escape(station.place), "page": page}
    row = _Row(station)
    return [
        {"id": row.id("tab"), "type": "tab", "label": f"gelgate {station.place}"},
        {
            "id": row.id("broker"),
            "type": "mqtt-broker",
            "name": f"broker {host}",
            "broker": host,
            "port": str(port),
            "protocolVersion": "5",
            "usetls": has_tls,
        },
        *row.subscription("last/press", "json", _KEEP_JSON, shown=True),
        *row.subscription("gel", "json", _KEEP_JSON),
        *row.subscription("state", "json", _KEEP_JSON),
        *row.subscription("availability", "utf8", _KEEP_JSON),
        *row.subscription("last/heatmap", "buffer", _KEEP_PICTURE),
        row.node("page", "http in", 140, ["read"], url=page, method="get"),
        row.node("read", "function", 340, ["draw"], func=_READ, outputs=1),
        row.node("draw", "template", 540, ["answer"], template=page_html, syntax="mustache", field="payload"),
        row.next().node("picture", "http in", 140, ["give"], url=f"{page}/picture.png", method="get"),
        row.node("give", "function", 340, ["answer"], func=_GIVE_PICTURE, outputs=1),
        row.node("answer", "http response", 740, [], headers={}),
    ]


class _Row:
    """The nodes of one flow: ids that are the same at every export, and a place on the tab."""

    def __init__(self, station: DescribedStation) -> None:
        self._station = station
        self._y = 60

    def id(self, name: str) -> str:
        return hashlib.sha256(f"{self._station.id}/{name}".encode()).hexdigest()[:16]

    def next(self) -> "_Row":
        self._y += 60
        return self

    def node(self, name: str, kind: str, x: int, leads_to: list[str], **more: Any) -> dict[str, Any]:
        place = {"x": x, "y": self._y, "wires": [[self.id(one) for one in leads_to]] if leads_to else []}
        return {"id": self.id(name), "type": kind, "z": self.id("tab"), "name": name, **more, **place}

    def subscription(
        self, topic: str, datatype: str, func: str, *, shown: bool = False
    ) -> list[dict[str, Any]]:
        keep, log = f"keep {topic}", f"log {topic}"
        options = {"topic": f"{self._station.root}/{topic}", "qos": "1", "datatype": datatype}
        nodes = [
            self.node(
                topic, "mqtt in", 140, [keep], **options, broker=self.id("broker"), nl=False, rap=True, rh=0
            ),
            self.node(keep, "function", 340, [log] if shown else [], func=func, outputs=1),
        ]
        if shown:
            nodes.append(
                self.node(log, "debug", 540, [], complete="payload.verdict", targetType="msg", active=True)
            )
        self.next()
        return nodes
