"""A small bench: the whole path of a press, from a frame to the broker and a subscriber."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import gelgate
from station import FPS, HEADER, Motion, gel, jpeg, press_recording, small_bundle

from calibration.experiments.tradeoff.bench import STAGES
from calibration.experiments.tradeoff.bench_command import read_medians
from calibration.experiments.tradeoff.gateway_process import _list_needed
from edge.core.contact.press_detector import PressDetector
from edge.model.bundle import Bundle
from edge.recording.format import Recording, RecordingWriter


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A bundle, and a recording of three presses, of a camera that sends fewer frames than it advertises."""
    folder = tmp_path_factory.mktemp("bench")
    bundle = small_bundle(folder / "pz0", press_recording(folder / "nominal", 12, seed=1))
    presses = press_recording(folder / "presses", 3, seed=2)
    header = presses / "recording.toml"
    header.write_text(header.read_text().replace(f"nominal_fps = {FPS}", "nominal_fps = 25.0"))
    return bundle, presses


def count_looks(bundle: Path, recorded: Path) -> int:
    """The frames of a recording that the contact detector decodes."""
    judge = Bundle.load(bundle)
    detector = PressDetector(judge.profile, witness=judge.free_reference)
    return sum(detector.feed(one.frame).level is not None for one in Recording.open(recorded))


def test_every_stage_of_every_press_has_its_time(station: tuple[Path, Path], tmp_path: Path) -> None:
    """Each press comes to the outbox and to a subscriber, with its picture; stages add up; floors are positive."""
    words = ("--presses", 3, "--idle", 4, "--threads", 1, "--folder", tmp_path, "--json")
    ended = gelgate("lab", "bench", *station, *words)
    assert ended.code == 0, ended.err
    found = json.loads(ended.out)
    stages = found["stages"]
    assert set(stages) == set(STAGES)
    path = ("verdict", "outbox", "acknowledged", "subscriber", "picture")
    assert [stages[name]["count"] for name in path] == [3] * 5
    assert 0 < stages["look"]["count"] <= count_looks(*station)
    order = [stages[name]["median"] for name in path if name != "subscriber"]
    assert order == sorted(order)
    assert min(found["floors"].values()) > 0
    assert found["idle"]["core_share"] > found["sensor_share"] > 0
    assert found["idle"]["presses"] == 0
    assert found["pressing"]["presses"] > 0
    assert found["pressing"]["press_cpu_ms"] > 0
    assert found["frame"]["fps"] == pytest.approx(FPS)
    # The first of ten frames comes at the first multiple of 1/18.75 s that is half a second.
    assert found["pressing"]["start_s"] > found["pressing"]["warm_up_s"] == pytest.approx(19 / FPS)
    assert 0 < found["bare"]["memory_bytes"] < found["pressing"]["memory_bytes"]
    assert 0 < found["bare"]["imports_s"] < found["pressing"]["start_s"]
    cv2 = found["packages"]["opencv-contrib-python-headless"]
    assert cv2["installed"] > cv2["in_memory"] > 1e6
    assert "torch" not in found["packages"]
    assert found["machine"]["threads"] == 1

    page = gelgate("lab", "bench", *station, *words[:-1]).out
    assert "of that opencv-contrib-python-headless" in page
    assert set(read_medians(page)) == set(STAGES)


@pytest.mark.parametrize(("presses", "free"), [(1, 0), (0, 28)])
def test_a_recording_without_free_frames_or_presses_is_refused(
    station: tuple[Path, Path], tmp_path: Path, presses: int, free: int
) -> None:
    """One sentence, before a gateway runs: it would wait for a press for ever."""
    recording = press_recording(tmp_path / "presses", presses, motion=Motion(free=free))
    ended = gelgate("lab", "bench", station[0], recording)
    assert ended.code == 3
    assert "does not begin with frames that are labelled as free, with presses after" in ended.sentence()


def test_a_recording_of_another_mode_is_refused(station: tuple[Path, Path], tmp_path: Path) -> None:
    """Before the gateway that looks at the free gel, which would only end."""
    header = replace(HEADER, mode=(64, 48), profile="")
    with RecordingWriter(tmp_path / "small", header) as writer:
        for number in range(40):
            press = None if number < 28 else 0
            writer.add(
                jpeg(gel(np.random.default_rng(number))[:48, :64]), number * 53_333_333, {"press": press}
            )
    ended = gelgate("lab", "bench", station[0], tmp_path / "small", "--idle", 8)
    assert ended.code == 3
    assert "use a bundle made for this sensor's mode" in ended.sentence()


def test_a_needed_package_not_installed_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described = tmp_path / "lone-1.0.dist-info"
    described.mkdir()
    needs = "Requires-Dist: nowhere-to-be-found\nRequires-Dist: numpy\n"
    (described / "METADATA").write_text(f"Name: lone\nVersion: 1.0\n{needs}")
    monkeypatch.syspath_prepend(tmp_path)
    assert _list_needed("lone") == {"numpy"}
