"""Every built-in plugin passes the published checks, and each check fails for a plugin that is wrong in one way."""

import contextlib
import dataclasses
import json
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import benches
import numpy as np
import pytest

from calibration.experiments.harness.study import methods_to_compare
from edge import registry
from edge.core.detector import Bank, Features, HasReference, Nominal, ScoreMaps
from edge.core.errors import FrameCorrupt, GelgateError
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Message
from edge.core.press import Press
from edge.core.sink_context import Station
from edge.core.verdict import Kind
from edge.messaging.command_payloads import NoArguments
from edge.messaging.result_payload import ResultPayload
from edge.press_stage import Alarms, Command, PressStage, StageParts
from plugins import conformance
from plugins.conformance import (
    DETECTOR_CHECKS,
    DEVICE_CHECKS,
    FEATURE_CHECKS,
    OVERVIEW_CHECKS,
    SINK_CHECKS,
    DetectorCase,
    DeviceBench,
    FeatureCase,
    open_played,
)

ROOT = Path(__file__).resolve().parents[2]


def named(check: Callable[..., None]) -> str:
    return check.__name__


@pytest.mark.parametrize("check", DETECTOR_CHECKS, ids=named)
@pytest.mark.parametrize("method", registry.names("detectors"))
def test_a_built_in_detector_conforms(method: str, check: Callable[[DetectorCase], None]) -> None:
    check(DetectorCase(registry.detector(method)))


def test_the_built_in_detectors_say_what_lists_of_names_would() -> None:
    """The model card compares those that are no baseline; all have oracles."""
    detectors = {name: registry.detector(name) for name in registry.names("detectors")}
    compared = json.loads((ROOT / "plugins/backbones/tactile_resnet18_evaluation.json").read_text())[
        "settings"
    ]

    assert set(methods_to_compare()) == set(compared)
    assert all(isinstance(one, HasReference) for one in detectors.values())


BUILT_IN = [
    pytest.param(make_bench, check, id=f"{name}-{check.__name__}")
    for made, checks in (
        (benches.DEVICES, DEVICE_CHECKS),
        (benches.OVERVIEWS, OVERVIEW_CHECKS),
        (benches.SINKS, SINK_CHECKS),
    )
    for name, make_bench in made.items()  # type: ignore[attr-defined]
    for check in checks
]


@pytest.mark.parametrize(("make_bench", "check"), BUILT_IN)
def test_a_built_in_plugin_conforms(make_bench: benches.Make[Any], check: Callable[[Any], None]) -> None:
    with make_bench() as bench:
        check(bench)


# A blocked read ends with OpenCV's own timeout, which counts as a lost sensor.
WITHOUT_DEADLINES = ("check_the_deadline_is_kept", "check_after_the_last_frame")


@pytest.mark.parametrize(
    "check", [check for check in DEVICE_CHECKS if named(check) not in WITHOUT_DEADLINES], ids=named
)
def test_the_v4l2_reader_conforms_but_for_deadlines(check: Callable[[DeviceBench], None]) -> None:
    check(benches.V4l2Bench())


def test_every_built_in_device_overview_camera_and_sink_has_a_bench() -> None:
    """A new plugin cannot be forgotten here. The real sensor is read by the driver that usb_mock drives, or by V4L2; a
    Sparkplug node and the page make something else of messages, where the checks expect the same bytes."""
    assert {*registry.names("overviews")} == {*benches.OVERVIEWS}
    assert {*registry.names("devices")} == {*benches.DEVICES, "gelsight_mini"}
    assert {*registry.names("sinks")} == {
        *(name.partition(" ")[0] for name in benches.SINKS),
        "sparkplug",
        "page",
    }


SUBSPACE: Any = registry.detector("subspace")


class Shown:
    """A part of the inner thing, which one of that name on the changed thing hides."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, changed: Any, kind: type) -> Any:
        return getattr(changed._inner, self._name)


class Changed:
    """Something else with some of its parts replaced."""

    def __new__(cls, inner: Any, **parts: Any) -> Any:
        # From Python 3.12 on the check against a protocol does not ask `__getattr__`.
        shown = {name: Shown(name) for name in dir(inner) if not name.startswith("_")}
        return super().__new__(type("Changed", (cls,), shown))

    def __init__(self, inner: Any, **parts: Any) -> None:
        self._inner = inner
        vars(self).update(parts)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def fails(checks: tuple[Callable[[Any], None], ...], name: str, subject: Any) -> None:
    """The check of that name fails on the subject. Errors: Failed where it passes, StopIteration for no such check."""
    check = next(check for check in checks if check.__name__ == name)
    with pytest.raises((AssertionError, KeyError, TypeError, ValueError, RuntimeError, GelgateError)):
        check(subject)


def fit_changed(change: Callable[[Bank], Bank]) -> Any:
    return lambda *given: change(SUBSPACE.fit(*given))


def with_array(bank: Bank, change: Callable[[np.ndarray], np.ndarray]) -> Bank:
    name = next(name for name, array in bank.arrays.items() if array.dtype == np.float32)
    return dataclasses.replace(bank, arrays={**bank.arrays, name: change(bank.arrays[name])})


def in_place(nominal: Nominal, *others: Any) -> Bank:
    bank = SUBSPACE.fit(nominal, *others)
    next(iter(nominal.features.values()))[0, 0] = 7
    return bank


def repaired(nominal: Nominal, grid: Any, parameters: Any, *others: Any) -> Bank:
    """Learns from whatever it is given, and from invented presses where there are none."""
    features = {tap: np.nan_to_num(maps, posinf=0.0) for tap, maps in nominal.features.items()}
    if nominal.presses == 0:
        features = DetectorCase(SUBSPACE).presses(3, 1)
    return SUBSPACE.fit(Nominal(features), grid, parameters, *others)


def wrong_reference(*given: Any) -> ScoreMaps:
    found = SUBSPACE.reference_score(*given)
    return ScoreMaps(found.score_map * 1.01, found.score)


WRONG_DETECTORS = {
    "check_it_is_a_detector": SimpleNamespace(name="half"),
    "check_parameters": Changed(SUBSPACE, parameters=lambda mode="corrected", **_: SUBSPACE.parameters(mode)),
    "check_fit_can_be_repeated": Changed(SUBSPACE, fit=in_place),
    "check_bank": Changed(SUBSPACE, fit=fit_changed(lambda bank: with_array(bank, lambda a: a.astype(np.float64)))),
    "check_head": Changed(SUBSPACE, head=lambda *given: SUBSPACE.head(*given).replace(b"score_map", b"score_mop")),
    "check_it_compares_places_if_it_says_so": Changed(SUBSPACE, compares_places=True),
    "check_reference": Changed(SUBSPACE, reference_score=wrong_reference),
    "check_no_presses": Changed(SUBSPACE, fit=repaired),
    "check_features_that_are_not_finite": Changed(SUBSPACE, fit=repaired),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_DETECTORS)
def test_a_wrong_detector_is_noticed(name: str) -> None:
    fails(DETECTOR_CHECKS, name, DetectorCase(WRONG_DETECTORS[name]))


class CaseWithScores(DetectorCase):
    """SUBSPACE with a graph that answers differently."""

    change: Callable[[ScoreMaps], ScoreMaps]

    def score(self, features: Features, bank: Bank) -> ScoreMaps:
        return type(self).change(super().score(features, bank))


def scores_by(change: Callable[[ScoreMaps], ScoreMaps]) -> DetectorCase:
    return type("Case", (CaseWithScores,), {"change": staticmethod(change)})(SUBSPACE)


WRONG_SCORES = {
    "check_a_press_is_scored_by_itself": lambda found: ScoreMaps(found.score_map, found.score - found.score.mean()),
    "check_damage_scores_higher": lambda found: ScoreMaps(found.score_map, np.zeros_like(found.score)),
    "check_one_press": lambda found: ScoreMaps(found.score_map * np.nan, found.score),
    "check_equal_presses": lambda found: ScoreMaps(found.score_map * np.nan, found.score),
    "check_a_press_that_is_not_finite_does_not_pass": lambda found: ScoreMaps(
        np.nan_to_num(found.score_map), np.where(np.isfinite(found.score_map).all(), found.score, 0)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_SCORES)
def test_a_wrong_graph_is_noticed(name: str) -> None:
    """Where the graph, and not the fit, is wrong."""
    fails(DETECTOR_CHECKS, name, scores_by(WRONG_SCORES[name]))


def test_every_fact_that_does_not_hold_is_named() -> None:
    """One exception group, with the fact in the notes of each failure."""
    with pytest.raises(ExceptionGroup, match=r"detector subspace: 2 of \d+ checks failed") as caught:
        conformance.check_detector(WRONG_DETECTORS["check_no_presses"])

    notes = " ".join(note for error in caught.value.exceptions for note in error.__notes__)
    assert "check_no_presses: A fit without presses" in notes
    assert "check_features_that_are_not_finite" in notes


def test_a_sound_detector_passes_without_a_word() -> None:
    conformance.check_detector(SUBSPACE)


def corrupt_delivered(device: Any, deadline: int) -> CameraFrame:
    try:
        return device.read(deadline)
    except FrameCorrupt:
        return CameraFrame(b"", 0, 0)


def always_again(device: Any, deadline: int) -> CameraFrame:
    """The last frame where there is no new one."""
    with contextlib.suppress(GelgateError):
        device.last = device.read(deadline)
    return device.last


def twice(device: Any, deadline: int) -> CameraFrame:
    device.last, before = (
        getattr(device, "last", None) or device.read(deadline),
        getattr(device, "last", None),
    )
    if before is not None:
        device.last = None
    return before or device.last


def cut(device: Any, deadline: int) -> CameraFrame:
    return dataclasses.replace(device.read(deadline), payload=b"\xff\xd8")


def timeless(device: Any, deadline: int) -> CameraFrame:
    return dataclasses.replace(device.read(deadline), timestamp_ns=0)


def closes_once(device: Any) -> None:
    if vars(device).setdefault("is_over", False):
        raise RuntimeError("closed already")
    device.is_over = True
    device.close()


def another_mode(device: Any) -> Any:
    return Changed(device, identity=dataclasses.replace(device.identity, mode=(1, 1)))


def patient(device: Any, deadline: int) -> CameraFrame:
    return device.read(deadline + 10**12)


WRONG_DEVICES = {
    "check_it_knows_who_it_is": another_mode,
    "check_frames_are_untouched": lambda device: Changed(device, read=lambda deadline: cut(device, deadline)),
    "check_a_frame_has_its_time": lambda device: Changed(device, read=lambda deadline: timeless(device, deadline)),
    "check_the_deadline_is_kept": lambda device: Changed(device, read=lambda deadline: patient(device, deadline)),
    "check_a_frame_comes_once": lambda device: Changed(device, read=lambda deadline: twice(device, deadline)),
    "check_a_damaged_frame": lambda device: Changed(device, read=lambda deadline: corrupt_delivered(device, deadline)),
    "check_unplugged": lambda device: Changed(device, read=lambda deadline: always_again(device, deadline)),
    "check_closed_twice": lambda device: Changed(device, close=lambda: closes_once(device)),
    "check_after_the_last_frame": lambda device: Changed(device, read=lambda deadline: always_again(device, deadline)),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_DEVICES)
def test_a_wrong_device_is_noticed(name: str, tmp_path: Path) -> None:
    bench = benches.RecordedBench(tmp_path)
    opened = bench.open
    fails(DEVICE_CHECKS, name, Changed(bench, open=lambda *a, **k: WRONG_DEVICES[name](opened(*a, **k))))


def altered(sink: Any, message: Message) -> None:
    sink.send(dataclasses.replace(message, payload=message.payload.upper()))


def picky(sink: Any, message: Message) -> None:
    if message.payload == b"{":
        raise ValueError("no JSON")
    sink.send(message)


def forgetful(sink: Any, message: Message) -> None:
    if b'"gel_presses":7,' not in message.payload:
        sink.send(message)


def silent_after_close(sink: Any) -> Any:
    wrong = Changed(sink)
    wrong.close = lambda: vars(wrong).update(send=lambda message: None)
    return wrong


WRONG_SINKS = {
    "check_messages_arrive": lambda sink: Changed(sink, send=lambda message: altered(sink, message)),
    "check_any_payload": lambda sink: Changed(sink, send=lambda message: picky(sink, message)),
    "check_threads": lambda sink: Changed(sink, send=lambda message: forgetful(sink, message)),
    "check_a_receiver_that_is_away": lambda sink: sink,
    "check_a_receiver_that_is_away_at_the_start": lambda sink: sink,
    "check_a_message_that_is_refused": lambda sink: sink,
    "check_closed_twice": silent_after_close,
}


@pytest.mark.parametrize("name", WRONG_SINKS)
def test_a_wrong_sink_is_noticed(name: str) -> None:
    """By the check that is about what is wrong; a list in memory never notices that its receiver is away or refuses."""
    bench = benches.MemoryBench()
    opened = bench.open
    subject = Changed(
        bench,
        open=lambda station: WRONG_SINKS[name](opened(station)),
        take_away=lambda: True,
        unwanted=lambda: Message("result", b"no"),
    )
    fails(SINK_CHECKS, name, subject)


@pytest.mark.parametrize("name", ["check_messages_arrive", "check_threads", "check_closed_twice"])
def test_a_sink_that_reads_a_result_gets_results(name: str) -> None:
    """One that writes some fields alone, such as a row of a table, can pass the checks."""
    bench = benches.MemoryBench()
    opened = bench.open

    def read(sink: Any, message: Message) -> None:
        if message.topic == "result":
            assert ResultPayload.model_validate_json(message.payload).part == "bolt"
        sink.send(message)

    def wrapped(station: Station) -> Any:
        sink = opened(station)
        return Changed(sink, send=lambda message: read(sink, message))

    next(check for check in SINK_CHECKS if check.__name__ == name)(Changed(bench, open=wrapped))


def test_a_played_station_gives_the_verdicts_that_are_named(tmp_path: Path) -> None:
    """So a feature is tested on the presses that it is about."""
    with open_played(tmp_path, presses=("fail", "pass", "fail", "fail")) as station:
        station.play()
        assert [result.verdict for result in station.results] == ["fail", "pass", "fail", "fail"]


class Lamp(PressStage):
    """A feature that is sound; each below is wrong in one way."""


class Unexplained(Lamp):
    commands = (Command("lamp", NoArguments, lambda stage, given: {}, ""),)


class Passing(Lamp):
    def judge(self, press: Press, *_: object) -> Press:
        assert press.verdict is not None
        return dataclasses.replace(press, verdict=dataclasses.replace(press.verdict, kind=Kind.PASS))


class Scoring(Lamp):
    def record(self, press: Press, gel: object) -> None:
        assert press.score is not None


class Raising(Lamp):
    def __init__(self, alarms: Alarms | None = None) -> None:
        self.alarm = alarms

    @classmethod
    def open(cls, parts: StageParts) -> "Raising":
        return cls(parts.alarms)

    def record(self, press: Press, gel: object) -> None:
        assert self.alarm is not None
        self.alarm.say("lamp", "it is on")


class Mistranslated(Lamp):
    words: ClassVar = {"de": {"it takes {watts} W": "Bedarf: {watt} W"}}


class Answering(Lamp):
    commands = (Command("lamp", NoArguments, lambda stage, given: {"press": stage}, "what it shows"),)


class Once(Lamp):
    """It makes its table when it is opened, and again at the next start."""

    @classmethod
    def open(cls, parts: StageParts) -> "Once":
        parts.store.write("lamp", lambda connection: connection.execute("CREATE TABLE lamp (press)"))
        return cls()


class Closing(Lamp):
    is_over = False

    def close(self) -> None:
        assert not self.is_over
        self.is_over = True


WRONG_FEATURES = {
    "check_it_is_a_feature": Unexplained,
    "check_presses_are_recorded": Passing,
    "check_presses_without_a_score": Scoring,
    "check_alarms_are_declared": Raising,
    "check_words": Mistranslated,
    "check_requests": Answering,
    "check_a_restart": Once,
    "check_closed_twice": Closing,
}


@pytest.mark.parametrize("name", WRONG_FEATURES)
def test_a_wrong_feature_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the check that is about what is wrong; a sound one passes it."""
    points = registry._points
    for kind in (Lamp, WRONG_FEATURES[name]):
        monkeypatch.setitem(globals(), "installed", kind)
        lamp = [EntryPoint("lamp", f"{__name__}:installed", "gelgate.features")]
        found = {**points("features"), "lamp": lamp}
        monkeypatch.setattr(
            registry, "_points", lambda group, found=found: found if group == "features" else points(group)
        )
        if kind is Lamp:
            next(check for check in FEATURE_CHECKS if check.__name__ == name)(FeatureCase("lamp"))
    fails(FEATURE_CHECKS, name, FeatureCase("lamp"))


class ResultsBench(benches.MemoryBench):
    """Its sink keeps results alone, as their length."""

    def open(self, station: Any) -> Any:
        sink, ours = super().open(station), Message("result", b"")

        def send(message: Message) -> None:
            if message.topic == ours.topic:
                sink.send(dataclasses.replace(message, payload=b"%d" % len(message.payload)))

        return Changed(sink, send=send)


class TranslatingBench(ResultsBench):
    def arrives(self, topic: str, message: Message) -> tuple[str, bytes] | None:
        return (topic, b"%d" % len(message.payload)) if topic.endswith("/result") else None


def test_a_sink_that_translates_is_checked_where_its_bench_says_how() -> None:
    """Else what it leaves out or writes in another form is a message lost."""
    conformance.check_sink(TranslatingBench)
    with pytest.raises(ExceptionGroup):
        conformance.check_sink(ResultsBench)


def test_each_check_has_a_plugin_that_fails_it() -> None:
    """A new check cannot be forgotten here."""
    names = {check.__name__ for check in (*DETECTOR_CHECKS, *DEVICE_CHECKS, *FEATURE_CHECKS, *SINK_CHECKS)}

    assert names == {*WRONG_DETECTORS, *WRONG_SCORES, *WRONG_DEVICES, *WRONG_FEATURES, *WRONG_SINKS}


class ChangedOverview:
    """The drawn overview camera, changed after it was opened."""

    def __init__(self, change: Callable[[Any], Any]) -> None:
        self._bench = benches.VirtualBench()
        self.clock, self._change = self._bench.clock, change

    def open(self) -> Any:
        return self._change(self._bench.open())


def reading(device: Any, **fields: Any) -> Any:
    """Each of its frames with these fields."""
    return Changed(device, read=lambda deadline_ns: dataclasses.replace(device.read(deadline_ns), **fields))


WRONG_OVERVIEWS: dict[str, Callable[[Any], Any]] = {
    "check_it_knows_who_it_is": lambda device: Changed(
        device, identity=dataclasses.replace(device.identity, serial="")
    ),
    "check_pictures_are_complete": lambda device: Changed(
        device, identity=dataclasses.replace(device.identity, mode=(64, 48))
    ),
    "check_pictures_come_in_order": lambda device: reading(device, sequence=3),
    "check_closed_twice": lambda device: Changed(device, close=lambda: None),
}


@pytest.mark.parametrize("check", [check.__name__ for check in OVERVIEW_CHECKS])
def test_a_wrong_overview_camera_is_noticed(check: str) -> None:
    """For every check there is a camera that is wrong in that way alone."""
    fails(OVERVIEW_CHECKS, check, ChangedOverview(WRONG_OVERVIEWS[check]))
