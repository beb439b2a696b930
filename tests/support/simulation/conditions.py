"""What a run should sometimes reach: a simulator is judged by these, for what it never reaches it does not check."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from simulation.alarms import RECORDED, SEEN
from simulation.brokers import Broker
from simulation.bundles import PARTS
from simulation.chosen import MOODS
from simulation.configuration import KINDS
from simulation.lives import Station
from simulation.options import MESSAGES
from simulation.outputs import GATE, LAMP, OVERLOAD, REJECT
from simulation.plc import STEPS
from simulation.plc_lines import PORTS
from simulation.shelf import BROKEN
from simulation.surroundings import World
from simulation.web import GUESSES

SOMETIMES = (
    *(
        f"{fault}{when}"
        for fault in (
            *("sensor unplugged", "sensor silent", "sensor frozen", "sensor covered", "another sensor"),
            *("frames corrupt", "frames truncated", "frames broken inside", "frames jitter"),
            *("frames in a burst", "process frozen", "loop hangs", "disk full", "disk slow", "disk errs"),
            *("disk nearly full", "golden frames otherwise"),
        )
        for when in ("", " during a press")
    ),
    *(f"relay {mood}" for mood in ("unplugged", "slow", "stuck")),
    *(f"pedal {mood}" for mood in ("unplugged", "stuck", "trodden")),
    "a person asked for a verdict with the pedal",
    "a person trod on the pedal, and nothing pressed",
    *(f"a broker {mood}" for mood in sorted(set(MOODS))),
    *(f"a person {kind}" for kind in KINDS),
    *(f"the disk failed to {what}" for what in ("read", "write", "sync")),
    *(f"a {kind} request" for kind in ("signed", "forged", "unsigned", "repeated")),
    "a person called a part good",
    "a person called a part damaged",
    "a person took a sound part for damaged",
    *(f"the alarm {rule.alarm} was raised for its reason" for rule in (*SEEN, *RECORDED) if rule.raised_s),
    "a snapshot was asked for",
    "a snapshot was written",
    "a shadow was refused",
    "two requests had one transaction",
    *(f"overview {mood}" for mood in ("unplugged", "silent", "frozen", "broken")),
    "the code on a part selected its bundle",
    "a press was refused, for the overview camera saw nothing",
    "a master piece was asked for",
    "a master piece was pressed",
    "the free gel was learnt again",
    "marks on a gel went by themselves",
    "the free gel was learnt again while something pressed",
    "the alarm pulse was acknowledged",
    "the alarm counts was acknowledged",
    "the wall clock drifts",
    "the gel was replaced while the disk was full",
    "a part that nobody saw put down lay there",
    "a part lay there before and after a time without sight",
    "a person began another piece than the PLC",
    "a part change came as a press began, or after its verdict",
    "restarted while the disk was full",
    "a start failed, and the next one did not",
    "killed between presses",
    "the wall clock went back",
    "the wall clock went on",
    "the wall clock was set while a broker was away",
    "the gel was replaced",
    "the gel was replaced while a broker was away",
    "the gel could not be replaced",
    "the part was changed",
    "a part change came during a press, and waited",
    "the bundles were opened again",
    "the bundles were opened again during a press",
    "restarted",
    "restarted during a press",
    "restarted with the sinks in another order",
    *(f"killed at {statement}" for statement in ("BEGIN", "COMMIT", "a file")),
    "killed during a press",
    "writes were lost with the power",
    "killed while a broker was away",
    "killed while the disk was full",
    "ended with a press and a result that waited, and then a broker came back",
    "the store refused a press",
    "the store took what had waited",
    "the hand lifted because the station asked for it",
    "a row was sent twice and counts once",
    "a result came late, and said so",
    "a dented part failed",
    "a press had no verdict",
    "a score was not a number",
    "a press was lost, with a reason",
    "two presses had different parts",
    "a lamp showed a pass",
    "a pulse threw out a part",
    "a pulse let a part through",
    "a pulse was not given in time",
    "the database was removed",
    "a picture was dropped from a full outbox",
    "a pass was dropped from a full outbox",
    "a fail was dropped from a full outbox",
    "the alarm outbox_full was acknowledged",
    "a file has results",
    "a press was not judged, for nobody asked",
    "a shadow passed what failed",
    "a robot lifted at the word of the station",
    "a robot was told nothing, and lifted",
    "a robot was told of an overload",
    *(f"a PLC was shown {word} over {plc}" for word in ("pass", "fail", "error", "place") for plc in PORTS),
    *(f"the cable of a PLC was pulled at {step}" for step in STEPS),
    "a pass was taken back from a PLC",
    "a second PLC was refused",
    "a second PLC wrote",
    "a PLC had two places pressed, and the piece passed",
    "a PLC began a piece at a place that comes later",
    *(f"a person selected the {which} place of a piece" for which in ("right", "wrong")),
    *(f"a piece was {verdict}" for verdict in ("pass", "fail", "incomplete")),
    "a piece took too long",
    "plc mute",
    "plc slow",
    *(f"database locked{when}" for when in ("", " during a press")),
    *(f"another program {what} at the database" for what in ("writes", "reads", "is alone")),
    "the loop waited for a database that was locked",
    *(f"a bundle was {kind}{when}" for kind in ("newer", *BROKEN) for when in ("", " during a press")),
    "a start was refused for its bundle",
    "killed while it started",
    "restarted as soon as the loop did not hang any more",
    *(
        f"a second sensor was beside {whose}, {what}"
        for whose in ("one that is named", "any")
        for what in ("stays", "first is unplugged", "restart")
    ),
    *(f"the page was asked {how}" for how in (*sorted(GUESSES), "with its token")),
)


def reached_at_end(world: World, station: Station) -> Iterator[str]:
    """What the end of a run shows."""
    yield from station.reached
    for broker in world.brokers.values():
        yield from _of_broker(broker)
    words = {seen.word for seen in station.seen}
    channels = {one.channel for one in world.relay.switched}
    found = {
        "a dented part failed": "fail" in words,
        "a score was not a number": "error" in words,
        "a press had no verdict": bool(words & {"rejected", "error"}),
        "a press was lost, with a reason": len(station.seen) < len(world.hand.presses),
        "a lamp showed a pass": LAMP in channels,
        "a robot was told of an overload": OVERLOAD in channels,
        "a pulse threw out a part": REJECT in channels,
        "a pulse let a part through": GATE in channels,
        "a pulse was not given in time": "pulse" in station.loop.parts.status.view().alarms,
    }
    dropped = station.dropped_before + Counter(station.dropped)
    for kind, name in (("heatmap", "picture"), ("pass", "pass"), ("fail", "fail")):
        found[f"a {name} was dropped from a full outbox"] = dropped[kind] > 0
    found["a press was not judged, for nobody asked"] = any(
        not press.is_asked for press in world.hand.presses
    )
    asked = dict(
        station.disk.read("SELECT verb, outcome FROM acts WHERE verb = 'snapshot' ORDER BY outcome = 'done'")
    )
    found["a master piece was pressed"] = bool(station.disk.read("SELECT 1 FROM reference_presses"))
    found["a snapshot was written"] = asked.get("snapshot") == "done"
    robots = [
        press for press in world.hand.presses if world.hand.may_lift and press.way != "brief" and press.end_ns
    ]
    found["a robot lifted at the word of the station"] = world.hand.lifted_at_word > 0
    found["a robot was told nothing, and lifted"] = len(robots) > world.hand.lifted_at_word
    found["the loop waited for a database that was locked"] = station.shared.has_waited
    found["a file has results"] = (station.disk.folder / MESSAGES / "messages.jsonl").exists()
    results = [same[0] for broker in world.brokers.values() for same in broker.results.values()]
    found["the code on a part selected its bundle"] = any(
        one["part_codes"] and one["verdict"] == "pass" and one["part"] == PARTS[1] for one in results
    )
    found["a press was refused, for the overview camera saw nothing"] = any(
        str(one["reason"]).startswith("no_overview") for one in results
    )
    found["a shadow passed what failed"] = any(one["shadow"] and one["verdict"] == "fail" for one in results)
    yield from (name for name, is_so in found.items() if is_so)
    yield from _of_plcs(world)
    pieces = [same[0] for broker in world.brokers.values() for same in broker.pieces.values()]
    yield from (f"a piece was {piece['verdict']}" for piece in pieces)
    yield from ("a piece took too long" for piece in pieces if piece["ended_by"] == "time")


def _of_plcs(world: World) -> Iterator[str]:
    for plc in world.plcs:
        words = [[word for word, _ in asked.words] for asked in plc.asked.values()]
        yield from (f"a PLC was shown {said[0]} over {world.server.kind}" for said in words if said)
        passed = {
            asked.piece for asked in plc.asked.values() if [word for word, _ in asked.words][:1] == ["pass"]
        }
        placed = {
            asked.piece for asked in plc.asked.values() if [word for word, _ in asked.words][:1] == ["place"]
        }
        if passed & placed:
            yield "a PLC had two places pressed, and the piece passed"
        yield from ("a pass was taken back from a PLC" for said in words if said == ["pass", "error"])
        yield from (f"the cable of a PLC was pulled at {step}" for step in plc.cuts)
        begun = {asked.piece: asked for asked in reversed(plc.asked.values()) if asked.taken_ns}
        if world.has_pieces and world.worker.order == "fixed":
            is_late = any(asked.part == PARTS[1] and asked.busy_ns for asked in begun.values())
            yield from ["a PLC began a piece at a place that comes later"] * is_late
    for plc in world.plcs[1:]:
        yield "a second PLC wrote" if plc.writes_ns else "a second PLC was refused"


def _of_broker(broker: Broker) -> Iterator[str]:
    results = [broker.results[press_id] for press_id in broker.order]
    if any(len(one) > 1 for one in results):
        yield "a row was sent twice and counts once"
    if any(one["is_replayed"] for same in results for one in same):
        yield "a result came late, and said so"
    if any(first[0]["part"] != second[0]["part"] for first, second in pairwise(results)):
        yield "two presses had different parts"
