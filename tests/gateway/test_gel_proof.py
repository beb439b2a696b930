"""A new gel through a station: the state says that the bundle is not yet proven on it, until presses have shown it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from station import Motion, press_recording, station_config
from stepped_station import SteppedStation

from edge.core.gel_proof import Proven
from edge.core.verdict import Kind
from edge.store import gel_proofs
from edge.store.acts import CONFIRM, Act
from edge.store.gel_proofs import GelBundle, of_mounted


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five presses, the fourth one dented."""
    folder = tmp_path_factory.mktemp("proof") / "presses"
    return press_recording(folder, 5, dented=[3], motion=Motion(hold=8, idle=34), seed=5)


@pytest.fixture
def replaced(tmp_path: Path, recording: Path, bundle: Path) -> Callable[..., SteppedStation]:
    """A station with one press on its first gel and this number on the second, whose picture is learnt."""

    def make(unproven: str = "warn", presses_since: int = 0) -> SteppedStation:
        table = f'[gel]\nunproven = "{unproven}"'
        station = SteppedStation(station_config(tmp_path, recording, bundle, tables=table))
        station.play_presses(1)
        assert (station.said("state")["unproven"], station.alarm("gel_proof")) == (None, None)
        station.ask("replace_gel")
        station.play(30)
        station.play_presses(1 + presses_since)
        return station

    return make


def test_a_new_gel_is_a_state_and_an_alarm(replaced: Callable[..., SteppedStation], tmp_path: Path) -> None:
    """With the gel before and the presses since, after a restart too. A damaged part on it counts as an alarm, for the
    station does not know that it is damaged. With enough presses a person may say that it is proven."""
    with replaced(presses_since=2) as station:
        text, alarm = station.said("state")["unproven"], station.said("alarm/gel_proof")
        assert station.verdicts == [Kind.PASS] * 3
        station.play_presses(4)
        assert "on this gel 1 of 3 presses alarmed, which allows" in station.said("state")["unproven"]
    with SteppedStation(tmp_path / "gelgate.toml") as again:
        again.play_until(lambda: again.loop.session is not None)
        assert "on this gel 1 of 3 presses alarmed" in again.said("state")["unproven"]
        with pytest.raises(ValueError, match=r"Press \d+ more sound parts"):
            again.ask("prove_gel")
        key = GelBundle("TEST0001", "TEST0001-2", again.bundle_id)
        for _ in range(60):
            again.parts.store.write("pressing", partial(gel_proofs.count, key=key, is_alarm=False))
        answer = again.ask("prove_gel")
        assert again.alarm("gel_proof") is None

    assert (answer["presses"], answer["alarms"], 0.05 < answer["rate"] < 0.1) == (63, 1, True)
    assert text.startswith("bundle PZ0/pos1 (")
    assert "is not yet proven on gel TEST0001-2: it was used on gel TEST0001-1; on this gel" in text
    assert (alarm["text"], alarm["severity"]) == (text, "warning")


def test_parts_are_refused_where_that_is_configured(replaced: Callable[..., SteppedStation]) -> None:
    """The station halts, and a press is rejected with the reason; it is not scored and does not count."""
    with replaced("refuse") as station:
        assert station.said("state")["state"] == "halted"
        station.play_presses(2)
        result = station.results[-1]

        assert (result.verdict, result.score) == (Kind.REJECTED, None)
        assert str(result.reason).startswith("gel_proof: bundle PZ0/pos1")
        assert "it has scored no press on this gel yet" in station.said("state")["unproven"]


def test_what_people_say_of_presses_ends_it_without_a_request(
    replaced: Callable[..., SteppedStation], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A press that they call damaged, and one of the gel before, count nothing; one that they call good does."""
    with replaced(presses_since=2) as station:
        monkeypatch.setattr("edge.core.gel_proof.PROVEN_RATE", 0.95)
        before, first, second = station.results

        def say(press_id: str, verdict: str) -> object:
            arguments = {"press_id": press_id, "verdict": verdict}
            act = Act(station.clock.time_ns(), "kim, at the page", CONFIRM, press_id + verdict, arguments)
            act_id, _ = station.parts.store.begin_act(act, 60.0)
            station.ask(CONFIRM, **arguments)
            station.parts.store.finish_act(act_id, "done")
            for _ in range(3):
                station.clock.sleep(1.5)
                station.turn()
            return station.said("state")["unproven"]

        assert say(before.press_id, "good") is not None
        assert say(first.press_id, "damaged") is not None
        assert say(second.press_id, "good") is None
        assert station.alarm("gel_proof") is None
        (_, _, proof) = station.parts.store.read("reading", of_mounted)[0]
        assert (proof.proven, proof.presses, proof.alarms) == (Proven.PRESSES, 1, 0)


def test_it_may_be_said_in_the_state_alone(replaced: Callable[..., SteppedStation]) -> None:
    """With `off` there is no alarm."""
    with replaced("off") as station:
        assert station.said("state")["unproven"] is not None
        assert station.alarm("gel_proof") is None
