"""One station of a month, for a day: the real gateway without threads, its sensor, its operator and its person."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from calibration.experiments.month.gel import FRAME_S, MountedGel
from calibration.experiments.month.plan import PlannedPress
from calibration.simulator.field_of_view import LR
from edge.clock import ManualClock
from edge.config import load_config
from edge.core.errors import DeviceStalled
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import DeviceIdentity
from edge.core.verdict import Cause
from edge.gateway.build import open_station
from edge.gateway.command_table import every_command
from edge.gateway.opening import BundleOpener
from edge.gateway.preflight import Preflight
from edge.gateway.recorder import PressReport
from edge.model.session import TrunkSessions
from edge.store.acts import CONFIRM, Act
from edge.store.ulid import new_ulid

__all__ = ["DayStation", "write_config"]

SERIAL: Final = "SIM00001"
# 5 January 2026, noon UTC: the first shift begins.
_BEGIN_NS: Final = 1_767_614_400 * 10**9
_DAY_NS: Final = 86_400 * 10**9

# The share of answers that are wrong.
_WRONG_ANSWERS: Final = 0.03
# A gel that was mounted today is changed again after so many presses at the earliest.
_LEAST_PRESSES: Final = 100
# How often a piece is pressed at most.
_MOST_PRESSES: Final = 3
# Free gel before the first press: the station learns its picture.
_LEARN_S: Final = 2.0
_WIPE_S: Final = 3.5
_GEL_ALARMS: Final = frozenset({"gel_mark", "gel_scar"})

CONFIGURATION: Final = """version = 1
[device]
plugin = "usb_mock"
options = {{ recording = "nominal" }}
[inspection]
bundle = "{bundle}"
shadows = [{shadows}]
press_again = "unsure"
threads = 1
[store]
path = "gelgate.db"
free_mb = 1
[archive]
presses = {archived}
mb = 20000
[commands]
page = ["confirm_press"]
[confirm]
questions_per_day = {questions}
[[sinks]]
plugin = "memory"
"""
"""Of a station: what is configured is what the pages recommend; all else is by default."""


def write_config(
    folder: Path, bundle: Path, archived: int, questions: int = 10, shadow: Path | None = None
) -> Path:
    """Write the configuration of a station. archived: presses that its archive keeps. questions: of a day at most."""
    path, shadows = folder / "gelgate.toml", "" if shadow is None else f'"{shadow.absolute()}"'
    text = CONFIGURATION.format(
        bundle=bundle.absolute(), shadows=shadows, archived=archived, questions=questions
    )
    path.write_text(text, encoding="utf-8")
    return path


@dataclass
class DayCounts:
    """What happened at one station on one day. Pieces count by the verdict of their last press."""

    pieces: int = 0
    sound: int = 0
    not_sound: int = 0
    """Damaged, or of another part."""
    escapes: int = 0
    """Not sound, and passed."""
    false_alarms: int = 0
    """Sound, and not passed in the end: fail, unsure or no verdict."""
    unsure: int = 0
    """Pieces that are unsure in the end, sound or not."""
    no_verdict: int = 0
    """Pieces without one in the end: rejected, or not noticed."""
    pressed_again: int = 0
    """Presses that the station asked for beyond the first of a piece."""
    wiped: int = 0
    """How often the station had the gel wiped."""
    asked: int = 0
    """Presses that the person was asked about."""
    answered_wrongly: int = 0
    alarms: Counter[str] = field(default_factory=Counter)
    """How often each was raised."""
    escaped: Counter[str] = field(default_factory=Counter)
    """What passed: a kind of damage, or `wrong`."""
    causes: Counter[str] = field(default_factory=Counter)
    """What the station blames for its false alarms."""
    must_learn: bool = False
    """Whether the station says at the end of the day that it is time to learn."""
    unproven: str | None = None
    """Why the bundle is not proven on the gel, at the end of the day."""


class _Sensor:
    """A sensor that gives the frame that was made last."""

    def __init__(self) -> None:
        self.identity = DeviceIdentity("GelSight Mini R0B SIM0-0001", SERIAL, LR.size, round(1 / FRAME_S, 2))
        self.newest: CameraFrame | None = None

    def read(self, deadline_ns: int) -> CameraFrame:
        frame, self.newest = self.newest, None
        if frame is None:
            raise DeviceStalled("no frame yet")
        return frame

    def close(self) -> None:
        """Nothing is held."""


class DayStation:
    """One station, opened in the morning and closed in the evening."""

    def __init__(self, config: Path, day: int, gel: MountedGel, trunks: TrunkSessions) -> None:
        self.counts, self.day, self.gel = DayCounts(), day, gel
        self.clock = ManualClock(_BEGIN_NS + day * _DAY_NS)
        self._config, self._trunks = config, trunks
        self._reports: list[PressReport] = []
        self._known = config.with_name("truths.json")
        self._truths: dict[str, str] = json.loads(self._known.read_text()) if self._known.exists() else {}
        self._sensor, self._sequence = _Sensor(), 0
        self._raised: frozenset[str] = frozenset()
        self._gel_doubts, self._morning = 0, gel
        self._rng = gel.month.streams("person", day)

    @contextmanager
    def open(self) -> Iterator["DayStation"]:
        """Open it, and close it in order."""
        config = load_config(self._config)
        checked = Preflight(BundleOpener(None, config.inspection.threads, self.clock))
        checked.opener.trunks = self._trunks
        checked.open_bundles(config)
        for finding in checked.findings:
            if finding.error is not None:
                raise finding.error
        checked.open_device = lambda: self._sensor
        with ExitStack() as closing:
            opened = open_station(config, self.clock, self._reports.append, checked)
            self._loop = closing.enter_context(opened)
            yield self
            self._loop.parts.calls.close(self._loop)

    @property
    def date(self) -> str:
        """Today, by the line's calendar."""
        return datetime.fromtimestamp(self.clock.time_ns() / 1e9).date().isoformat()

    def begin(self, first: PlannedPress, *, is_new_gel: bool) -> None:
        """Show the free gel, wiped; a new one is recorded as such. first: the press that comes first."""
        self._show(self.gel.free(first, _LEARN_S))
        if is_new_gel:
            self._record_gel(first)

    def press(self, press: PlannedPress) -> None:
        """Press a piece, again where the station says so, and count what became of it."""
        counts, truth = self.counts, press.truth
        if press.speck is not None:
            self.gel.specks.append(press.speck)
        for attempt in range(_MOST_PRESSES):
            report = self._press_once(press, attempt)
            word = "lost" if report is None else report.word
            if word == "pass" or attempt == _MOST_PRESSES - 1 or not self._is_asked(report, press):
                break
            counts.pressed_again += 1
        if word == "pass" and "gel_mark" in self._raised:  # nothing fails by it, and the page says to wipe
            self.wipe(press)
        counts.pieces += 1
        counts.unsure += word == "unsure"
        counts.no_verdict += word not in ("pass", "fail", "unsure")
        if truth == "sound":
            counts.sound += 1
            counts.false_alarms += word != "pass"
            if word != "pass":
                blame = None if report is None else report.press.blame
                counts.causes[blame.cause.value if blame else word] += 1
        else:
            counts.not_sound += 1
            counts.escapes += word == "pass"
            counts.escaped[press.kind or truth] += word == "pass"

    def end(self) -> None:
        """Let the person answer what the station asks, and look at its state."""
        self._known.write_text(json.dumps(self._truths), encoding="utf-8")
        self._turn(1.5)
        questions = self._said("questions")
        for question in [] if questions is None else questions["presses"]:
            self._answer(str(question["press_id"]))
        state = self._said("state")
        self.counts.unproven = None if state is None else state.get("unproven")
        self._turn(1.5)
        self._note_alarms()
        self.counts.must_learn = "false_alarms" in self._raised

    def adopt_shadow(self) -> str | None:
        """Let the shadow take over; return why it does not, None where it does."""
        try:
            weigh = self._ask("adopt_shadow")
            weigh()
        except ValueError as error:
            return str(error)
        self._turn(1.0)
        return None

    def _press_once(self, press: PlannedPress, attempt: int) -> PressReport | None:
        before = len(self._reports)
        self._show(self.gel.press(press, attempt))
        self._show(self.gel.free(press, press.lift_s))
        reports = self._reports[before:]
        for report in reports:
            is_gel = press.truth == "sound" and report.word != "pass" and self.gel.is_marked(press)
            self._truths[report.press.press_id] = (
                "gel" if is_gel else "good" if press.truth == "sound" else "damaged"
            )
        self._gel_doubts = self._gel_doubts + 1 if _GEL_ALARMS & self._raised else 0
        return reports[-1] if reports else None

    def _is_asked(self, report: PressReport | None, press: PlannedPress) -> bool:
        """Do what the station says: wipe the gel, mount another one, where its alarm for the gel is there again at the
        next press and the gel is not too new, and press again. Returns whether the piece is pressed again."""
        blame = None if report is None else report.press.blame
        is_doubted = (blame is not None and blame.cause is not Cause.PART) or bool(_GEL_ALARMS & self._raised)
        is_new = self.gel is not self._morning and press.number - self.gel.since < _LEAST_PRESSES
        if self._gel_doubts > 1 and not is_new:
            self._mount(press)
        elif is_doubted:
            self.wipe(press)
        word = "lost" if report is None else report.word
        return is_doubted or word not in ("pass", "fail")

    def wipe(self, press: PlannedPress) -> None:
        """Wipe dust off the gel; scars stay."""
        self.counts.wiped += 1
        self.gel.specks.clear()
        self._show(self.gel.free(press, _WIPE_S))

    def _mount(self, press: PlannedPress) -> None:
        """Mount another gel before a press is made again."""
        self.gel, self._gel_doubts = MountedGel(self.gel.month, self.gel.number + 1, press.number), 0
        self._show(self.gel.free(press, _LEARN_S))
        self._record_gel(press)

    def _record_gel(self, press: PlannedPress) -> None:
        self._ask("replace_gel")
        self._show(self.gel.free(press, _LEARN_S))

    def _show(self, frames: Iterable[bytes]) -> None:
        for payload in frames:
            self._sequence += 1
            self._sensor.newest = CameraFrame(payload, self.clock.monotonic_ns(), self._sequence)
            parts = self._loop.parts
            parts.acquisition.step()
            if self._sensor.newest is not None:  # the first step has opened the sensor
                parts.acquisition.step()
            frame = parts.acquisition.next(0)
            self._loop.step(frame)
            self._note_alarms()
            self.clock.sleep(FRAME_S)
        self._loop.parts.pictures.step()
        for worker in self._loop.parts.publisher.workers.values():
            while worker.step() == 0:
                pass

    def _turn(self, seconds: float) -> None:
        """Let the loop turn without a frame."""
        for _ in range(max(1, round(seconds / 0.5))):
            self.clock.sleep(0.5)
            self._loop.step(None)

    def _note_alarms(self) -> None:
        raised = self._loop.parts.status.view().alarms
        for alarm in raised - self._raised:
            self.counts.alarms[alarm] += 1
        self._raised = raised

    def _answer(self, press_id: str) -> None:
        """Answer as the page does: what the piece is, now and then the opposite."""
        saying = self._truths[press_id]
        self.counts.asked += 1
        if self._rng.uniform() < _WRONG_ANSWERS:
            self.counts.answered_wrongly += 1
            saying = "good" if saying == "damaged" else "damaged"
        arguments = {"press_id": press_id, "verdict": saying}
        now_ns, store = self.clock.time_ns(), self._loop.parts.store
        act = Act(now_ns, "a person, at the page", CONFIRM, new_ulid(now_ns), arguments)
        act_id, _ = store.begin_act(act, 60.0)
        self._ask(CONFIRM, **arguments)
        store.finish_act(act_id, "done")

    def _ask(self, verb: str, **arguments: Any) -> Any:
        command = next(one for one in every_command() if one.verb == verb)
        return command.do(self._loop, command.arguments.of(arguments))

    def _said(self, topic: str) -> Any:
        """Return what the station says now on a topic without a history; None where it is empty."""
        messages = self._loop.parts.publisher.retained_state.since(-1)
        payload = next((message.payload for _, message in messages if message.topic == topic), b"")
        return json.loads(payload) if payload else None
