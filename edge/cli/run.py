"""`gelgate run` and `gelgate check`."""

import logging
import os
import signal
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from edge import logs
from edge.cli.options import CONFIG, ConfigOption
from edge.clock import SystemClock, local_time
from edge.config import load_config
from edge.core.errors import DeviceError, GelgateError
from edge.core.printable import score_texts, write_count
from edge.gateway.build import open_station
from edge.gateway.opening import played_recording
from edge.gateway.preflight import preflight
from edge.gateway.recorder import PressReport
from edge.gateway.report import Summary
from edge.logs import press_event
from edge.store.database import refuse_left_journal

__all__ = ["check", "example", "press_line", "run", "summary_text"]

# What a line of the log says of a press; the rest is in the result that is published.
_LOGGED = {
    "sequence",
    "part",
    "position",
    "verdict",
    "reason",
    "error",
    "score",
    "threshold",
    "latency_ms",
    "gel_id",
}

StateOption = Annotated[
    Path | None,
    typer.Option("--state-dir", help="The folder of a relative store.path; that of the file by default."),
]


def run(
    config: ConfigOption = CONFIG,
    presses: Annotated[int | None, typer.Option(min=1, help="Stop after this number of presses.")] = None,
    wait_for_device: Annotated[
        bool,
        typer.Option("--wait-for-device", help="Start without a sensor and wait for it, as a service does."),
    ] = False,
    state_dir: StateOption = None,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Log each contact event and each message that a sink takes."),
    ] = False,
    log_json: Annotated[
        bool, typer.Option("--log-json", help="Log JSON lines, presses too, instead of text.")
    ] = False,
) -> None:
    """Run the gateway: inspect every press and publish.

    It reads the sensor, scores every press, publishes the verdict and counts the press on its gel. Ctrl-C or SIGTERM
    ends it."""
    # A closed terminal (SIGHUP) ends it in good order; without a terminal SIGHUP reloads, as for a service, and one
    # that comes during the start is done after it.
    is_service, early = not os.isatty(0), threading.Event()
    if is_service:
        signal.signal(signal.SIGHUP, lambda *_: early.set())
    logs.start("json" if log_json else "text", is_verbose=verbose)
    os.umask(os.umask(0o077) | 0o027)  # results and counts are not for every user of the machine
    loaded = load_config(config, state_dir)
    refuse_left_journal(loaded.store.path)
    clock = SystemClock()
    with preflight(loaded, clock) as checked:
        for finding in checked.findings:
            if finding.error is not None and not (wait_for_device and isinstance(finding.error, DeviceError)):
                raise finding.error
        recording = played_recording(loaded.device)
        stop = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM, *(() if is_service else (signal.SIGHUP,))):
            signal.signal(number, lambda *_: stop.set())
        out = Lines()

        def print_press(report: PressReport) -> None:
            out.put(f"{local_time(report.result.time_ns)}  {press_line(report)}")

        on_press = log_press if log_json else print_press
        read_again = partial(load_config, config, state_dir)
        with open_station(loaded, clock, on_press, checked, read_again) as station:
            if is_service:
                signal.signal(signal.SIGHUP, lambda *_: station.reload())
            if early.is_set():
                station.reload()
            summary = station.run(stop, presses)
    if log_json:
        log_summary(summary)
    else:
        out.put(summary_text(summary))
    if recording is not None and summary.has_ended and loaded.inspection.trigger == "automatic":
        sensor = station.parts.acquisition.status
        recording.check_presses(summary.presses, sensor.frames, sensor.dropped)


class Lines:
    """Lines on standard output. Press does not depend on them: where they cannot be printed, they are left out."""

    def __init__(self) -> None:
        self._writer = logs.LineWriter(sys.stdout)
        self._is_open = True

    def put(self, line: str) -> None:
        """Print it, or say once in the log that lines are left out. A reader that pauses, such as a pager, keeps no
        press waiting, and is told how many it has missed."""
        if not self._is_open:
            return
        try:
            self._writer.put(f"{line}\n")
        except OSError as error:
            self._is_open = False
            logging.getLogger(__name__).warning(
                "press lines cannot be printed (%s) and are left out; inspection goes on",
                error.strerror or error,
            )


def check(
    config: ConfigOption = CONFIG,
    state_dir: StateOption = None,
    is_example: Annotated[
        bool, typer.Option("--example", help="Print a configuration to start from.")
    ] = False,
) -> None:
    """Check all that `run` needs; report every fault.

    Configuration, bundle, sensor, database and sinks are tried as at a start. Nothing is written."""
    if is_example:
        typer.echo(example(), nl=False)
        return

    loaded = load_config(config, state_dir)
    typer.echo(f"ok     configuration: {config}")
    refuse_left_journal(loaded.store.path)
    with preflight(loaded, SystemClock(), is_start=False) as checked:
        findings = checked.findings
    for finding in findings:
        typer.echo(f"{'ok    ' if finding.error is None else 'FAULT '} {finding.part}: {finding.text}")
    errors: list[GelgateError] = [finding.error for finding in findings if finding.error is not None]
    if errors:
        raise type(errors[0])(f"{len(errors)} of {len(findings)} checks failed; see above")


def example() -> str:
    """Read the configuration to start from, with each table."""
    return (Path(__file__).parents[1] / "service" / "example.toml").read_text(encoding="utf-8")


def summary_text(summary: Summary) -> str:
    """Say what a run did, in one or two lines; lost frames are always reported."""
    words = ", ".join(f"{n} {word}" for word, n in sorted(summary.verdicts.items())) or "none"
    frames = summary.frames
    text = (
        f"{write_count(summary.presses, 'press')}: {words}\n{write_count(frames.frames, 'frame')}: "
        f"{frames.dropped} dropped, {frames.late} late, {summary.frames_stale} repeated, "
        f"{summary.frames_corrupt} corrupt"
    )
    if frames.interrupted or frames.late_presses:
        text += (
            f"; frames were dropped {write_count(frames.interrupted, 'time')} while the gel was pressed and "
            f"{write_count(frames.late_presses, 'press')} came too late: this machine is too slow, presses may "
            "have been missed"
        )
    return text


def log_press(report: PressReport) -> None:
    """Log one press, its facts as fields."""
    result, gel = report.result, report.gel
    fields = {
        "event": "press",
        **result.model_dump(mode="json", include=_LOGGED),
        "gel_presses": gel.presses,
    }
    press_event(logging.getLogger(__name__), result.press_id, press_line(report), fields)


def log_summary(summary: Summary) -> None:
    """The end of a run in the log."""
    fields = {"event": "summary", "presses": summary.presses, "verdicts": dict(summary.verdicts)}
    log = logging.getLogger(__name__)
    log.info("%s", summary_text(summary).replace("\n", "; "), extra={"fields": fields})


def press_line(report: PressReport) -> str:
    """Write one press in one line: part, verdict, score against threshold, latency per stage, gel count."""
    result = report.result
    if result.score is None:
        outcome = result.error or result.reason or ""
    else:
        score, threshold = score_texts(result.score, result.threshold or 0.0)
        outcome = f"score {score:>8} / {threshold}"
    if result.press_again is not None and result.press_again.is_asked:
        outcome += "  PRESS AGAIN"
    stages = {stage: ms for stage, ms in result.latency_ms.items() if stage != "total"}
    total = result.latency_ms.get("total", 0.0)
    took = " ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())
    ahead = "done ahead: " if total < sum(stages.values()) else ""  # while the press came to rest
    verdict = (result.verdict or "error").upper()
    named = f"{label.kind} {label.piece}  " if (label := report.press.label) else ""
    sentences_text = "".join(f"  {sentence}" for sentence in report.sentences)
    return (
        f"{result.part}/{result.position or '-'}  {named}{verdict:8} {outcome}  "
        f"{total:6.1f} ms ({ahead}{took})  gel {report.gel.presses}/{report.gel.limit_presses}{sentences_text}"
    )
