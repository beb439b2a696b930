"""Who may ask a station for what: off by default, signed where it changes a record, done once, and written down."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from station import Configure
from stepped_station import SteppedStation

from edge.clock import ManualClock
from edge.config import load_config
from edge.core.errors import ConfigError, StoreError
from edge.gateway.command_table import every_command, station_commands
from edge.gateway.commands import (
    REPEATED_WITHIN_S,
    SIGNED_WITHIN_S,
    Change,
    CommandPolicy,
    Commands,
    policy_of,
)
from edge.messaging.command_payloads import signature_of, signed_text
from edge.store import acts
from edge.store.press_store import Store

SECRET = b"0123456789abcdef"
ROOT = "gelgate/site/line/station/gel/v1"
VERBS = frozenset(command.verb for command in every_command())
START_NS = 1_780_000_000 * 10**9


class Bench:
    """A store, a clock and three verbs that note what is done: `trigger`, `relearn` and `replace_gel`."""

    def __init__(self, store: Store, clock: ManualClock) -> None:
        self.done: list[str] = []
        self.store, self.clock = store, clock
        self.policy = CommandPolicy(
            ROOT,
            frozenset({"trigger"}),
            frozenset({"relearn", "replace_gel"}),
            SECRET,
            page=frozenset({"replace_gel"}),
        )
        self.commands = self.make()

    def make(self, per_minute: int = 60) -> Commands:
        handlers = {verb: self._handler(verb) for verb in ("trigger", "relearn", "replace_gel")}
        return Commands(handlers, self.policy, self.store, self.clock, per_minute)

    def _handler(self, verb: str) -> Callable[[Any], Change]:
        def do(arguments: Any) -> Change:
            if "fail" in arguments:
                raise ValueError("nothing presses the gel")
            self.done.append(verb)
            return Change({"number": len(self.done)}, {"presses": 900}, {"presses": 0})

        return do

    def ask(self, verb: str, transaction: str = "1", **more: Any) -> dict[str, Any]:
        payload = json.dumps({"transaction": transaction, **more}).encode()
        return dict(json.loads(self.commands(verb, payload)))

    def at_page(self, verb: str, transaction: str = "1", **more: Any) -> dict[str, Any]:
        """Ask as a person whom a page has admitted."""
        payload = json.dumps({"transaction": transaction, **more}).encode()
        return dict(json.loads(self.commands.from_page(verb, payload)))

    def signed(self, verb: str, transaction: str = "1", **changes: Any) -> dict[str, Any]:
        """Ask with a right signature; changes are made after it was signed."""
        time_ns, arguments = changes.pop("signed_ns", self.clock.time_ns()), {"gel_id": "b7"}
        text = signed_text(changes.pop("root", ROOT), verb, transaction, time_ns, "kim", arguments)
        fields = {"arguments": arguments, "by": "kim", "time_ns": time_ns}
        return self.ask(verb, transaction, **{**fields, "signature": signature_of(SECRET, text), **changes})


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    clock = ManualClock(START_NS)
    with Store(tmp_path / "gelgate.db", monotonic_ns=clock.monotonic_ns) as store:
        yield Bench(store, clock)


def test_only_a_trigger_is_served_by_default(station: SteppedStation, config: Path) -> None:
    """A station as it comes records no change of gel that somebody on the network asks for."""
    commands = Commands({}, policy_of(load_config(config)), station.parts.store, station.clock)
    commands._handlers = {verb: lambda arguments: Change({}) for verb in VERBS}
    answers = {verb: json.loads(commands(verb, b'{"transaction":"1"}')) for verb in VERBS}

    assert {verb for verb, answer in answers.items() if answer["status"] == "ok"} == {"trigger"}
    assert "is off at this station" in answers["replace_gel"]["error"]


def test_a_signed_request_is_done_and_written_down(bench: Bench) -> None:
    """Who, when, what, before and after."""
    answer = bench.signed("replace_gel")

    assert (answer["status"], bench.done) == ("ok", ["replace_gel"])
    (act,) = bench.store.acts()
    assert (act.who, act.verb, act.request) == ("kim, over MQTT, signed", "replace_gel", "1")
    assert act.outcome == "done"
    assert (act.arguments, act.before, act.after) == ({"gel_id": "b7"}, {"presses": 900}, {"presses": 0})
    assert act.time_ns == bench.clock.time_ns()


ANOTHER = "the signature is not that of this request"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"signature": None}, "needs time_ns and signature"),
        ({"time_ns": None}, "needs time_ns and signature"),
        ({"arguments": {"gel_id": "b8"}}, ANOTHER),
        ({"by": "lee"}, ANOTHER),
        ({"signature": "0" * 64}, ANOTHER),
        ({"root": "gelgate/site/line/other/gel/v1"}, ANOTHER),
        ({"signature": "x"}, "signature: it has another form than expected"),
        ({"signed_ns": START_NS - round((SIGNED_WITHIN_S + 1) * 1e9)}, "compare the clocks"),
        ({"signed_ns": START_NS + round((SIGNED_WITHIN_S + 1) * 1e9)}, "compare the clocks"),
    ],
)
def test_a_request_signed_otherwise_is_refused(bench: Bench, changes: dict[str, Any], words: str) -> None:
    """Each part of a request is signed, with its station and its time: a recorded request is no use later."""
    answer = bench.signed("replace_gel", **changes)

    assert answer["status"] == "error"
    assert words in answer["error"]
    assert bench.done == []


def test_a_repeated_request_is_not_done_again(bench: Bench) -> None:
    """MQTT delivers at least once: the second answer is the outcome of the first, and says so."""
    first, second = bench.ask("trigger", "7"), bench.ask("trigger", "7")

    assert (first["status"], second["status"], bench.done) == ("ok", "ok", ["trigger"])
    assert (first["is_repeated"], second["is_repeated"]) == (False, True)


def test_a_signed_request_is_never_done_twice(bench: Bench) -> None:
    """Also when the clock was set back and the gateway restarted: the signature is remembered."""
    at_ns = bench.clock.time_ns()
    bench.signed("replace_gel")
    bench.clock.sleep(REPEATED_WITHIN_S * 3)
    bench.commands = bench.make()

    answer = bench.signed("replace_gel", signed_ns=at_ns)
    bench.clock.sleep(-REPEATED_WITHIN_S * 3 + 1)
    again = bench.signed("replace_gel", signed_ns=at_ns)

    assert "compare the clocks" in answer["error"]
    assert again["is_repeated"]
    assert bench.done == ["replace_gel"]


def test_a_transaction_id_is_not_used_for_two_requests(bench: Bench) -> None:
    """Within a minute; a later one may be another request of a client that counts from 1 again."""
    bench.ask("trigger", "7")
    other = bench.ask("trigger", "7", arguments={"x": 1})
    bench.clock.sleep(REPEATED_WITHIN_S + 1)
    bench.ask("trigger", "7")

    assert "used for another request" in other["error"]
    assert bench.done == ["trigger", "trigger"]


def test_a_request_that_failed_may_be_asked_again(bench: Bench) -> None:
    """ "nothing presses the gel" is an answer for that moment; it is written down as a failure."""
    answers = [bench.ask("trigger", "7", arguments={"fail": True}) for _ in range(2)]

    assert [answer["error"] for answer in answers] == ["nothing presses the gel"] * 2
    assert [act.outcome for act in bench.store.acts()] == ["failed", "failed"]


def test_an_act_that_a_power_cut_interrupted_is_not_done_again_unseen(bench: Bench) -> None:
    """It is written before it is done: its row has no outcome, and the same request is answered with that."""

    def cut(*arguments: object) -> None:
        raise KeyboardInterrupt

    bench.commands._handlers["relearn"] = cut  # type: ignore[assignment]
    with pytest.raises(KeyboardInterrupt):
        bench.signed("relearn")
    bench.commands = bench.make()

    answer = bench.signed("relearn")

    assert "is being done, or was interrupted" in answer["error"]
    assert [act.outcome for act in bench.store.acts()] == [None]


@pytest.mark.parametrize(("by", "who"), [(None, "page"), ("kim", "kim, at the page")])
def test_a_request_from_the_page_is_done_without_a_signature(bench: Bench, by: str | None, who: str) -> None:
    """The page has admitted the person; the same handlers and the same table of acts."""
    answer = bench.at_page("replace_gel", by=by, arguments={"gel_id": "b7"})

    assert (answer["status"], answer["data"], bench.done) == ("ok", {"number": 1}, ["replace_gel"])
    (act,) = bench.store.acts()
    assert (act.who, act.outcome, act.arguments) == (who, "done", {"gel_id": "b7"})
    assert (act.before, act.after) == ({"presses": 900}, {"presses": 0})


def test_the_page_serves_its_own_verbs_alone(bench: Bench) -> None:
    """One that everybody may ask for over MQTT is not for the page by that; the refusal is written down."""
    answer = bench.at_page("trigger")

    assert "is off at the page of this station; name it in [commands]" in answer["error"]
    assert bench.done == []
    (act,) = bench.store.acts()
    assert (act.who, act.verb, act.outcome) == ("page", "trigger", "refused")
    assert bench.commands.page_verbs == {"replace_gel"}


@pytest.mark.parametrize("payload", [b'{"transaction":"7"}', b"\xff{"])
def test_what_a_page_refuses_is_answered_and_written_down(bench: Bench, payload: bytes) -> None:
    """Also where it cannot be read; nothing of it but its id is kept."""
    answer = json.loads(bench.commands.refuse_at_page("replace_gel", payload, "the token is wrong"))

    assert (answer["status"], answer["error"]) == ("error", "the token is wrong")
    assert bench.done == []
    (act,) = bench.store.acts()
    assert (act.who, act.outcome, act.sentence) == ("page", "refused", "the token is wrong")
    assert (act.request, act.arguments) == (answer["transaction"], {})
    bench.store.close()
    again = json.loads(bench.commands.refuse_at_page("replace_gel", payload, "the token is wrong"))
    assert again["error"] == "the token is wrong", "answered although it cannot be written down"


def test_a_flood_is_refused_and_fills_no_table(bench: Bench) -> None:
    """Sixty a minute are served; of the rest each is answered, none is done and none is written down."""
    answers = [bench.ask("trigger", str(n)) for n in range(200)]

    assert [answer["status"] for answer in answers] == ["ok"] * 60 + ["error"] * 140
    assert "more than 60 requests a minute" in answers[-1]["error"]
    assert (len(bench.done), len(bench.store.acts(1000))) == (60, 60)
    bench.clock.sleep(1)
    assert bench.ask("trigger", "later")["status"] == "ok"


@pytest.mark.parametrize("garbage", ["unreadable", "off", "unsigned", "copies"])
def test_garbage_keeps_nobody_out(bench: Bench, garbage: str, caplog: pytest.LogCaptureFixture) -> None:
    """Twenty a second over MQTT, for 20 s: each is answered, and signed requests and those of the page are done. The
    log and the table of acts grow by the rate alone."""
    bench.signed("replace_gel", "copied", signed_ns=bench.clock.time_ns() + 10**9)
    copied_ns = bench.clock.time_ns() + 10**9
    send: dict[str, Callable[[], Any]] = {
        "unreadable": lambda: json.loads(bench.commands("replace_gel", b"\xff{")),
        "off": lambda: bench.ask("reload"),
        "unsigned": lambda: bench.ask("replace_gel"),
        "copies": lambda: bench.signed("replace_gel", "copied", signed_ns=copied_ns),
    }
    answers: list[dict[str, Any]] = []
    garbage_answers: list[dict[str, Any]] = []
    for second in range(20):
        garbage_answers += [send[garbage]() for _ in range(20)]
        answers.append(bench.signed("replace_gel", f"s{second}"))
        answers.append(bench.at_page("replace_gel", f"p{second}"))
        bench.clock.sleep(1)

    assert [answer["status"] for answer in answers] == ["ok"] * 40
    assert all(answer["error"] or answer["is_repeated"] for answer in garbage_answers)
    assert sum(act.outcome == "refused" for act in bench.store.acts(2000)) <= 60 + 20
    assert sum("refused" in line for line in caplog.messages) <= 60 + 20 + 1


def test_refusals_push_no_acts_out_of_the_table(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are counted apart."""
    monkeypatch.setattr(acts, "KEPT_REFUSALS", 3)
    bench.signed("replace_gel")
    for n in range(10):
        bench.ask("relearn", f"t{n}")

    assert [act.outcome for act in bench.store.acts()] == ["refused"] * 3 + ["done"]


NUMBERS = (float("nan"), float("inf"))


@pytest.mark.parametrize(
    "asked",
    [
        {"transaction": "a\x1b[2J"},
        {"by": "a\x1b[2J"},
        *({"arguments": {"a": [{"b": one}]}} for one in NUMBERS),
    ],
)
def test_what_no_record_can_hold_is_refused_unrecorded(bench: Bench, asked: dict[str, Any]) -> None:
    """Control characters would be printed on somebody's terminal; with a number that is no JSON, SQLite could not read
    the table of acts any more."""
    assert bench.ask("trigger", **asked)["status"] == "error"
    assert (bench.done, bench.store.acts()) == ([], [])


@pytest.mark.parametrize("change", [{"gel_id": "\x00"}, {"note": "a\x1b[2J"}])
def test_control_characters_of_a_gel_are_refused(bench: Bench, change: dict[str, str]) -> None:
    """From the command line too."""
    with pytest.raises(StoreError, match="holds control characters"):
        bench.store.replace_gel("S1", 1, **change)


def admit(path: Path) -> None:
    """Read who may ask for what, as a start does."""
    station_commands(config := load_config(path))
    policy_of(config)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('unsigned = ["trigge"]', "no command is named 'trigge'; did you mean 'trigger'?"),
        ('signed = ["relearn"]', "signed verbs need secret_file"),
        ('signed = ["trigger"]\nsecret_file = "s"', "trigger: a verb is signed or unsigned, not both"),
        ('signed = ["relearn"]\nsecret_file = "nowhere"', "cannot be read"),
        ('signed = ["relearn"]\nsecret_file = "short"', "holds 3 bytes, at least 16 are needed"),
        ('signed = ["relearn"]\nsecret_file = "open"', "is open to every user"),
        ("requests_per_minute = 0", "requests_per_minute"),
        ('page = ["select_par"]', "no command is named 'select_par'; did you mean 'select_part'?"),
    ],
)
def test_a_policy_that_cannot_be_is_refused_at_the_start(
    configure: Configure, tmp_path: Path, table: str, words: str
) -> None:
    """In one sentence, by `gelgate check` and `gelgate run`."""
    for name, content, rights in (("short", b"abc", 0o640), ("open", SECRET, 0o644)):
        (tmp_path / name).write_bytes(content)
        (tmp_path / name).chmod(rights)
    path = configure(tables=f"[commands]\n{table}")

    with pytest.raises(ConfigError) as caught:
        admit(path)
    assert words in str(caught.value)


def test_the_signature_is_that_of_the_manual() -> None:
    """A vector that other programs can test themselves with; checked with `openssl dgst -sha256 -hmac`. In which order
    a program sends its arguments is its own affair."""
    two = {"gel_id": "b7", "limit_presses": 9000}
    orders = [dict(items) for items in (two.items(), reversed(two.items()))]
    texts = [signed_text(ROOT, "replace_gel", "17", 1, None, arguments) for arguments in orders]
    text = signed_text(ROOT, "replace_gel", "17", 1_780_000_000_000_000_000, "kim", {"gel_id": "b7-ü"})

    assert text == (
        b'{"arguments":{"gel_id":"b7-\\u00fc"},"by":"kim","root":"gelgate/site/line/station/gel/v1",'
        b'"time_ns":1780000000000000000,"transaction":"17","verb":"replace_gel"}'
    )
    assert signature_of(SECRET, text) == "252bbd39fa4bbad3a3d5e183ddecf8e45c89ba8befebfe899ba9545749648cba"
    assert texts[0] == texts[1]
