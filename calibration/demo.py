"""`gelgate demo`: the complete product on one machine, without hardware, network or account.

A bolt is simulated and a bundle is fitted on presses of good bolts. A gateway inspects further presses on the virtual
sensor and publishes over a real broker, and a subscriber keeps the heatmaps. Only the sensor's bus and the bolt are
simulated. The sensor is played as fast as it is read, so that a busy machine takes longer and misses no press.
"""

import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edge.clock import SystemClock
from edge.core.errors import SinkUnavailable
from edge.core.imaging.image_bytes import kind
from edge.messaging.local_broker import LocalBroker

if TYPE_CHECKING:
    from edge.acquisition import AcquisitionStatus
    from edge.gateway.report import Summary

__all__ = ["demo"]

PART, POSITION = "PZ1", "pos1"
# 24 nominal presses promise one false alarm in 25 at best: the limit is the highest of their scores.
ALPHA = 0.04
SUBSCRIBER_TIMEOUT_S = 60.0
ROOT = "gelgate/demo/bench/station1/gel/v1"

CONFIG = """\
version = 1
[station]
site = "demo"
line = "bench"
station = "station1"
[device]
plugin = "usb_mock"
options = {{ recording = "{recording}", pace = 0 }}
[inspection]
bundle = "{bundle}"
[store]
path = "gelgate.db"
[[sinks]]
plugin = "mqtt"
options = {{ host = "{host}", port = {port}, protocol = "{protocol}" }}
"""


def demo(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for heatmaps, bundle and configuration.")
    ] = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the bolt and its damage.")] = 0,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the recordings too, about 190 MB.")] = False,
) -> None:
    """Simulate a bolt, fit a bundle, inspect, publish.

    The gateway runs on a virtual sensor and publishes over a real broker; the heatmaps are kept."""
    started = time.monotonic()
    heatmaps = output / "heatmaps"
    shutil.rmtree(heatmaps, ignore_errors=True)
    heatmaps.mkdir(parents=True)
    # The broker first: if none is installed, the error comes before a minute of work, not after it.
    with LocalBroker() as broker, tempfile.TemporaryDirectory(prefix="gelgate-demo-") as removed:
        nominal, test = _simulate(output / "recordings" if keep else Path(removed), seed)
        _fit(nominal, output / "bundle")
        tally = _inspect(output, output / "bundle", test, heatmaps, broker)
        tally.show(heatmaps)
        tally.check(test)
    typer.echo(f"\ndone in {time.monotonic() - started:.0f} s; try it again with --seed {seed + 1}")
    if not keep:
        typer.echo(f"with --keep its recordings stay, for `gelgate run -c {output / 'gelgate.toml'}`")


def _simulate(folder: Path, seed: int) -> tuple[Path, Path]:
    """Simulate good presses for the fit, and presses of which some are damaged."""
    from calibration.simulator.command import simulate

    typer.echo("simulating presses of good bolts, then of bolts of which some are damaged")
    folder /= f"seed-{seed}"
    simulate("demo", folder, seed, workers=min(4, os.cpu_count() or 1))
    return folder / "nominal", folder / "test"


def _fit(nominal: Path, bundle: Path) -> None:
    from calibration.fitting.command import fit

    given = {"sources": [nominal], "output": bundle, "part": PART, "position": POSITION, "alpha": ALPHA}
    fit(**given, register="never", augment="never", overwrite=True)


@dataclass
class _Tally:
    """The verdicts against the truth of the simulation."""

    damage: list[str]
    """Of each press in order, empty for a sound one."""
    verdicts: list[str] = field(default_factory=list)
    gel: str = "empty"
    received: int = 0
    summary: "Summary | None" = None
    status: "AcquisitionStatus | None" = None

    def add(self, line: str, verdict: str) -> None:
        number = len(self.verdicts)
        damage = self.damage[number] if number < len(self.damage) else ""
        self.verdicts.append(verdict)
        typer.echo(f"{line}  [{damage or 'sound'}]")

    def show(self, heatmaps: Path) -> None:
        seen = Counter(
            (bool(damage), verdict) for damage, verdict in zip(self.damage, self.verdicts, strict=False)
        )
        damaged = sum(map(bool, self.damage))
        typer.echo(f"\ngel ledger: {self.gel}")
        typer.echo(
            f"verdicts:   {seen[True, 'fail']} of {damaged} damaged presses failed, "
            f"{seen[False, 'pass']} of {len(self.damage) - damaged} sound ones passed"
        )
        typer.echo(f"subscriber: {self.received} results over MQTT; heatmaps in {heatmaps}/")
        _show_picture(heatmaps)

    def check(self, recording: Path) -> None:
        """Compare with the labels. Errors: PressesMissed, SinkUnavailable: a press or a result was lost."""
        from edge.recording.format import Recording

        if self.summary is not None and self.summary.has_ended and self.status is not None:
            seen, sensor = self.summary.presses, self.status
            Recording.open(recording).check_presses(seen, sensor.frames, sensor.dropped)
        if self.received != len(self.verdicts):
            raise SinkUnavailable(
                f"{len(self.verdicts)} presses were inspected and {self.received} results arrived at the subscriber "
                f"within {SUBSCRIBER_TIMEOUT_S:g} s; check the broker, and reduce the load of the machine"
            )


def _show_picture(heatmaps: Path) -> None:
    """Name the picture of the first damaged press, or of the first, and draw it where the terminal can."""
    import cv2
    import numpy as np

    from edge.pictures.terminal import draw_in_terminal

    pictures = sorted(heatmaps.iterdir())
    if picture := next((path for path in pictures if "-fail." in path.name), next(iter(pictures), None)):
        typer.echo(f"picture:    {picture}")
        rgb = np.ascontiguousarray(np.asarray(cv2.imread(str(picture)), np.uint8)[..., ::-1])
        draw_in_terminal(rgb, sys.stdout, os.environ)


def _inspect(folder: Path, bundle: Path, recording: Path, heatmaps: Path, broker: LocalBroker) -> _Tally:
    """Run the gateway and a subscriber on the test recording."""
    from edge.cli.run import press_line
    from edge.config import load_config
    from edge.gateway.build import open_station
    from edge.store.press_store import Store

    tally = _Tally(_read_damage(recording))
    for old in folder.glob("gelgate.db*"):
        old.unlink()
    shutil.rmtree(folder / "gelgate.references", ignore_errors=True)
    typer.echo(f"broker: {broker.kind} on {broker.host}:{broker.port}; inspecting on the virtual sensor\n")
    config = folder / "gelgate.toml"
    text = CONFIG.format(
        recording=recording.resolve(),
        bundle=bundle.resolve(),
        host=broker.host,
        port=broker.port,
        protocol=broker.level,
    )
    config.write_text(text, encoding="utf-8")
    with _subscriber(broker, heatmaps) as (received, complete):
        loaded = load_config(config)
        with open_station(
            loaded,
            SystemClock(),
            lambda report: tally.add(press_line(report), report.result.verdict or "error"),
        ) as station:
            tally.summary = station.run(threading.Event())
            tally.status = station.parts.acquisition.status
            # Before the gateway closes: it waits two seconds for unsent messages, and a busy machine needs more.
            _await(lambda: len(complete) >= len(tally.verdicts))
        tally.received = len(received)
    with Store(folder / "gelgate.db") as store:
        for gel in store.gels()[-1:]:  # none where the disk was full
            count = f"{gel.presses} of {gel.limit_presses} presses, {gel.state}"
            tally.gel = f"{gel.gel_id} on sensor {gel.serial}: {count}"
    return tally


def _read_damage(recording: Path) -> list[str]:
    """Read the labels of the simulation: how each press is damaged, empty for a sound one."""
    from edge.recording.format import Recording

    damage: dict[int, str] = {}
    for label in Recording.open(recording).labels():
        if label is not None and isinstance(label.get("press"), int):
            defect = label.get("defect")
            kind = f"{defect['kind']}, severity {defect['severity']:.2f}" if isinstance(defect, dict) else ""
            damage[int(str(label["press"]))] = kind
    return [damage[number] for number in sorted(damage)]


@contextmanager
def _subscriber(local: LocalBroker, heatmaps: Path) -> Iterator[tuple[dict[str, str], set[str]]]:
    """A subscriber: press id to verdict, in the order of arrival, and the presses of which the picture has come, too.

    Pictures are saved with the verdict in their name.
    """
    from edge.messaging.mqtt_broker import Broker, Received
    from edge.messaging.mqtt_connection import Connection

    results: dict[str, str] = {}
    complete: set[str] = set()

    def arrived(message: Received) -> None:
        topic = message.topic.removeprefix(ROOT + "/")
        if topic == "result":
            content = json.loads(message.payload)
            results[content["press_id"]] = content["verdict"] or "error"
            if content["heatmap_topic"] is None:
                complete.add(content["press_id"])
        elif topic.startswith("heatmap/") and topic.removeprefix("heatmap/") in results:
            press = topic.removeprefix("heatmap/")
            number = list(results).index(press) + 1
            if message.payload:
                (heatmaps / f"{number:02d}-{results[press]}.{kind(message.payload)}").write_bytes(
                    message.payload
                )
            complete.add(press)

    broker = Broker(local.host, local.port, "gelgate-demo-subscriber", level=local.level)
    with closing(Connection.open(broker, on_received=arrived)) as connection:
        connection.subscribe(f"{ROOT}/#")
        yield results, complete


def _await(is_done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + SUBSCRIBER_TIMEOUT_S
    while time.monotonic() < deadline and not is_done():
        time.sleep(0.05)
