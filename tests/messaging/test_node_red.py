"""The flow for Node-RED: sound as a graph, and its functions run where node is installed.

`make test-subscribers` runs it in a real Node-RED.
"""

import json
import shutil
import subprocess
from typing import Any

import pytest

from edge.messaging.descriptions.dashboards import flow
from edge.messaging.descriptions.station import DescribedStation
from edge.messaging.topics import TOPICS

from .conftest import ROOT

FLOW = flow(DescribedStation.of_root(ROOT), "broker.plant", 8883)


def test_every_wire_leads_to_a_node_of_the_flow() -> None:
    """Ids are used once, and every node is on the flow's own tab."""
    ids = [node["id"] for node in FLOW]
    tab = FLOW[0]["id"]

    assert len(set(ids)) == len(ids)
    assert {target for node in FLOW for port in node.get("wires", []) for target in port} <= set(ids)
    assert {node["z"] for node in FLOW if node["type"] not in ("tab", "mqtt-broker")} == {tab}


def test_it_listens_to_fixed_topics_of_the_station() -> None:
    """At the configured broker, as the manual names them."""
    broker = next(node for node in FLOW if node["type"] == "mqtt-broker")
    heard = [node for node in FLOW if node["type"] == "mqtt in"]

    assert (broker["broker"], broker["port"]) == ("broker.plant", "8883")
    assert {node["broker"] for node in heard} == {broker["id"]}
    own = {f"{ROOT}/{topic.name}".replace("<press id>", "+") for topic in TOPICS}
    assert {node["topic"] for node in heard} <= own


def test_two_stations_do_not_share_nodes() -> None:
    """Both can be imported into one Node-RED; the same station again replaces itself."""
    other = flow(DescribedStation.of_root(ROOT.replace("press2", "press3")))

    assert not {node["id"] for node in FLOW} & {node["id"] for node in other}
    assert flow(DescribedStation.of_root(ROOT), "broker.plant", 8883) == FLOW


def test_the_page_shows_a_place_as_text() -> None:
    """A name of the plant is no HTML, and its path is a valid address."""
    nodes = flow(DescribedStation.of_root("gelgate/<b>plant/Süd/press2/gel/v1"))
    page = next(node for node in nodes if node["type"] == "template")

    assert "<b>" not in page["template"]
    assert [node["url"] for node in nodes if node["type"] == "http in"] == [
        "/gelgate/%3Cb%3Eplant/S%C3%BCd/press2",
        "/gelgate/%3Cb%3Eplant/S%C3%BCd/press2/picture",
    ]


# Runs the functions of the flow on messages, in the order of the wires: what Node-RED does.
RUN = """
const [nodes, messages, page] = JSON.parse(require("fs").readFileSync(0));
const kept = {}, flow = { get: (key) => kept[key], set: (key, value) => { kept[key] = value; } };
const run = (node, msg) => new Function("msg", "flow", node.func)(msg, flow);
const after = (node) => nodes.find((one) => one.id === node.wires[0][0]);
for (const [topic, payload] of messages) {
    const node = nodes.find((one) => one.type === "mqtt in" && topic.startsWith(one.topic.replace("+", "")));
    run(after(node), { topic, payload: node.datatype === "buffer" ? Buffer.from(payload) : payload });
}
const answer = run(after(nodes.find((one) => one.name === page)), {});
console.log(JSON.stringify({ ...answer, payload: Buffer.isBuffer(answer.payload) ? "bytes" : answer.payload }));
"""


def answered(page: str, *messages: tuple[str, Any]) -> dict[str, Any]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("SKIPPED, NOT TESTED: node is not installed")
    given = [FLOW, [(f"{ROOT}/{topic}", payload) for topic, payload in messages], page]
    done = subprocess.run(
        [node, "-e", RUN], input=json.dumps(given), capture_output=True, text=True, check=True
    )
    return dict(json.loads(done.stdout))


VALUES = ("verdict", "ratio", "part", "presses", "limit", "state", "availability")


@pytest.mark.parametrize(
    ("messages", "shown"),
    [
        (
            [
                ("last/press", {"press_id": "x", "verdict": "fail", "score_ratio": 2.345, "part": "bolt"}),
                ("gel", {"presses": 3, "limit_presses": 1000, "state": "good"}),
                ("state", {"state": "ready", "reason": None}),
                ("availability", "online"),
            ],
            ("fail", "2.35", "bolt", 3, 1000, "ready", "online"),
        ),
        ([], ("no press yet", "")),
        ([("last/press", {"press_id": "x", "verdict": None, "score_ratio": None})], ("error", "")),
    ],
)
def test_the_page_shows_the_last_press(messages: list[tuple[str, Any]], shown: tuple[object, ...]) -> None:
    """Verdict, ratio, gel and state from the retained topics; before the first press, and after one without a score."""
    payload = answered("page", *messages)["payload"]

    assert tuple(payload[name] for name in VALUES[: len(shown)]) == shown


def press(press_id: str) -> tuple[str, Any]:
    return "last/press", {"press_id": press_id, "verdict": "pass"}


@pytest.mark.parametrize(
    ("messages", "shown"),
    [
        ([press("x"), ("heatmap/x", "\x89PNG x")], "bytes"),
        ([("last/heatmap", "\x89PNG x"), press("x")], "bytes"),  # retained ones come in any order
        ([press("x"), ("heatmap/x", "\x89PNG x"), press("y")], ""),
        ([press("x"), ("heatmap/x", "\x89PNG x"), ("heatmap/a master piece", "\x89PNG a")], "bytes"),
        ([press("x"), ("last/heatmap", "\x89PNG x"), ("last/heatmap", ""), press("y")], ""),
        ([press("x"), ("heatmap/x", "")], ""),
        ([("last/heatmap", "\x89PNG x")], ""),
    ],
)
def test_the_picture_is_that_of_the_last_press_or_none(messages: list[tuple[str, Any]], shown: str) -> None:
    """One of another press is not shown, whichever comes first; the id is inside."""
    answer = answered("picture", *messages)

    assert (answer["payload"], answer["statusCode"]) == (shown, 200 if shown else 404)
