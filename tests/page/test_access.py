"""Who may see the page and change something with it: addresses, names, origins, the token."""

from ipaddress import ip_network
from typing import Any

import pytest

from edge.clock import ManualClock
from edge.page.access import Access
from edge.page.changes import MOST_ADDRESSES, WRONG_PER_MINUTE, Changes, change_refusal

OWN = {"host": "gateway:8080", "content-type": "application/json"}
PLANT = Access((ip_network("192.168.1.0/24"), ip_network("fd00::/8")), ("gateway.plant",))


def sentence(access: Access, client: str, reached: str, host: str) -> str | None:
    refused = access.refusal(client, reached, host)
    return None if refused is None else refused.sentence


@pytest.mark.parametrize(
    ("client", "reached", "host"),
    [
        ("127.0.0.1", "127.0.0.1", "127.0.0.1:8080"),
        ("127.0.0.1", "127.0.0.1", "LOCALHOST:8080"),
        ("::1", "::1", "[::1]:8080"),
        ("192.168.1.20", "192.168.1.5", "192.168.1.5:8080"),
        ("192.168.1.20", "192.168.1.5", "gateway.plant"),
        ("192.168.1.20", "192.168.1.5", "Gateway.Plant.:80"),
        ("::ffff:192.168.1.20", "::ffff:192.168.1.5", "192.168.1.5:8080"),
        ("fd00::7%eth0", "fd00::5%eth0", "[fd00::5]:8080"),
        ("127.0.0.1", "127.0.0.1", "gateway.plant"),
    ],
)
def test_who_is_named_sees_the_page(client: str, reached: str, host: str) -> None:
    """By the address of this machine, or by a configured name."""
    assert sentence(PLANT, client, reached, host) is None


@pytest.mark.parametrize("client", ["192.168.2.20", "10.0.0.1", "fe80::1%eth0", "::ffff:10.0.0.1"])
def test_other_machines_do_not(client: str) -> None:
    """With their address, and where to allow it."""
    said = sentence(PLANT, client, "192.168.1.5", "192.168.1.5")
    assert f"is not shown to {client}; name its address in allow_from" in str(said)


@pytest.mark.parametrize(
    ("reached", "host"),
    [
        ("127.0.0.1", "attacker.example:8080"),
        ("127.0.0.1", "127.0.0.1.attacker.example"),
        ("127.0.0.1", "192.168.1.5"),
        ("192.168.1.5", "localhost"),
        ("192.168.1.5", "192.168.1.6"),
        ("127.0.0.1", ""),
        ("::1", "[::2]:8080"),
        ("127.0.0.1", "a\x1b[2J" + "b" * 5000),
    ],
)
def test_a_name_that_is_not_ours_is_refused(reached: str, host: str) -> None:
    """A name server of others may answer with our address: then a page of theirs would have our origin. The name came
    from outside, so what is said of it is short and printable."""
    said = str(sentence(PLANT, "127.0.0.1", reached, host))
    assert said.startswith("this page is not known as")
    assert len(said) < 400
    assert "\x1b" not in said


@pytest.mark.parametrize(
    ("more", "status"),
    [
        ({}, None),  # a program sends no origin
        ({"origin": "http://gateway:8080", "sec-fetch-site": "same-origin"}, None),
        ({"origin": "https://GATEWAY:8080"}, None),
        ({"content-type": "application/json; charset=utf-8"}, None),
        ({"origin": "http://attacker.example"}, 403),
        ({"origin": "http://gateway:9000"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "ftp://gateway:8080"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"content-type": "text/plain"}, 415),  # a form of another page can send text
        ({"content-type": "application/x-www-form-urlencoded"}, 415),
        ({"content-type": ""}, 415),
    ],
)
def test_the_page_may_ask_for_a_change_and_another_may_not(more: dict[str, str], status: int | None) -> None:
    refused = change_refusal({**OWN, **more})
    assert (refused and refused.status) == status


def gate(**options: Any) -> Changes:
    return Changes(None, options.get("token", b"correct-horse"), options.get("clock", ManualClock()))


@pytest.mark.parametrize(
    ("token", "authorization", "status", "words"),
    [
        (b"correct-horse", "Bearer correct-horse", None, ""),
        (b"correct-horse", "bearer  correct-horse ", None, ""),
        (b"correct-horse", "", 401, "needs the token"),
        (b"correct-horse", "Bearer", 401, "needs the token"),
        (b"correct-horse", "Basic correct-horse", 401, "needs the token"),
        (b"correct-horse", "Bearer correct-hors", 401, "not the token"),
        (b"correct-horse", "Bearer correct-horse2", 401, "not the token"),
        (b"correct-horse", "Bearer \xfc", 401, "not the token"),
        (None, "Bearer ", 403, "only shows"),
    ],
)
def test_who_has_the_token_is_admitted_and_others_are_recorded(
    token: bytes | None, authorization: str, status: int | None, words: str
) -> None:
    """The sentence holds neither token; where none is configured, nobody is admitted."""
    refused = gate(token=token).token_refusal("10.0.0.1", authorization)
    assert (refused and (refused.status, refused.is_recorded)) == (status and (status, True))
    assert refused is None or (words in refused.sentence and "horse" not in refused.sentence)


def test_guessing_is_limited_and_does_not_fill_the_table() -> None:
    """Ten wrong ones a minute from one address; then the right one is refused too, and nothing is recorded."""
    clock = ManualClock()
    one = gate(clock=clock)
    wrong = [one.token_refusal("10.0.0.1", f"Bearer guess-{n}") for n in range(WRONG_PER_MINUTE + 5)]
    right = one.token_refusal("10.0.0.1", "Bearer correct-horse")

    assert [refused and refused.status for refused in wrong] == [401] * WRONG_PER_MINUTE + [429] * 5
    assert right is not None
    assert (right.status, right.is_recorded) == (429, False)
    assert one.token_refusal("10.0.0.2", "Bearer correct-horse") is None
    clock.sleep(60)
    assert one.token_refusal("10.0.0.1", "Bearer correct-horse") is None


def test_the_addresses_that_are_counted_are_bounded() -> None:
    """Of a network with many."""
    one = gate()
    for n in range(MOST_ADDRESSES + 50):
        one.token_refusal(f"fd00::{n:x}", "Bearer guess")
    assert len(one._wrong._rates) <= MOST_ADDRESSES
