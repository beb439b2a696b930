"""One station with several receivers: each is served whatever the others do."""

import threading
from pathlib import Path

import pytest
from page_messages import asked
from ports import free_port
from station import JSONL, MQTT, Configure
from stepped_station import SteppedStation

from edge.store.outbox import Outbox
from plugins.sinks.jsonl import JsonlSink


def test_a_page_and_a_file_go_on_without_a_broker(configure: Configure, tmp_path: Path) -> None:
    """Three verdicts and their pictures, while the results wait for the broker; each result is in the file once."""
    port, away = free_port(), free_port()
    page = f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port} }}\n'
    sinks = MQTT % away + page + JSONL % (tmp_path / "out")
    with SteppedStation(configure(sinks=sinks)) as station:
        station.play()
        for _ in range(5):
            station.publish()
        presses, shown = asked(port, "/presses.json"), asked(port, "/station.json")

    assert [(one["verdict"], one["has_picture"]) for one in presses] == [
        ("pass", True),
        ("fail", True),
        ("pass", True),
    ]
    assert (shown["info"]["part"], shown["gel"]["presses"]) == ("PZ0", 3)
    assert (tmp_path / "out/messages.jsonl").read_text().count('"topic":"result"') == 3
    with Outbox(tmp_path / "gelgate.db") as outbox:
        waiting = [row.message.topic for row in outbox.pending(f"mqtt:127.0.0.1:{away}", 99)]
        assert waiting.count("result") == 3


def test_a_receiver_that_does_not_return_keeps_no_station_from_its_end(
    configure: Configure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as one whose name server hangs: it is closed by a thread of its own, and by no other."""
    monkeypatch.setattr("edge.messaging.publisher.CLOSE_S", 0.1)
    may_return, closers = threading.Event(), list[str]()

    def close(sink: JsonlSink) -> None:
        closers.append(threading.current_thread().name)
        if closers[-1].startswith("close-"):
            may_return.wait()

    monkeypatch.setattr(JsonlSink, "close", close)
    with SteppedStation(configure(sinks=JSONL % (tmp_path / "out"))):
        pass
    may_return.set()
    assert [name.partition("-")[0] for name in closers] == ["close"]
