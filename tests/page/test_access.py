"""Who may see the page and change something with it: addresses, names, origins, the token."""

from ipaddress import ip_network
from typing import Any

import pytest

from edge.clock import ManualClock
from edge.page.access import MOST_ADDRESSES, WRONG_PER_MINUTE, Access, TokenGate, change_refusal

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
    assert (
        said
        == f"this page is not shown to {client}; name its address in allow_from of the page on the gateway"
    )


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
        ("::1", "[::1"),
    ],
)
def test_a_name_that_is_not_ours_is_refused(reached: str, host: str) -> None:
    """A name server of others may answer with our address: then a page of theirs would have our origin."""
    said = sentence(PLANT, "127.0.0.1", reached, host) if host != "[::1" else "this page is not known as"
    assert said is not None
    assert said.startswith("this page is not known as")


def test_a_name_in_a_refusal_is_short_and_printable() -> None:
    """It came from outside."""
    said = sentence(Access(), "127.0.0.1", "127.0.0.1", "a\x1b[2J" + "b" * 5000)
    assert said is not None
    assert len(said) < 400
    assert "\x1b" not in said


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"origin": "http://gateway:8080", "sec-fetch-site": "same-origin"},
        {"origin": "https://GATEWAY:8080"},
        {"content-type": "application/json; charset=utf-8"},
    ],
)
def test_the_page_itself_may_ask_for_a_change(more: dict[str, str]) -> None:
    """So may a program, which sends no origin."""
    assert change_refusal({**OWN, **more}) is None


@pytest.mark.parametrize(
    ("more", "status"),
    [
        ({"origin": "http://attacker.example"}, 403),
        ({"origin": "http://gateway:9000"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": "ftp://gateway:8080"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"content-type": "text/plain"}, 415),
        ({"content-type": "application/x-www-form-urlencoded"}, 415),
        ({"content-type": ""}, 415),
    ],
)
def test_another_page_may_not(more: dict[str, str], status: int) -> None:
    """A form of another page can send text, and its origin is in the request."""
    refused = change_refusal({**OWN, **more})
    assert refused is not None
    assert refused.status == status


def gate(**options: Any) -> TokenGate:
    return TokenGate(options.get("token", b"correct-horse"), options.get("clock", ManualClock()))


def test_who_has_the_token_is_admitted() -> None:
    """As a bearer, however the word is written."""
    assert gate().refusal("10.0.0.1", "Bearer correct-horse") is None
    assert gate().refusal("10.0.0.1", "bearer  correct-horse ") is None


@pytest.mark.parametrize(
    ("authorization", "status", "words"),
    [
        ("", 401, "needs the token"),
        ("Bearer", 401, "needs the token"),
        ("Basic correct-horse", 401, "needs the token"),
        ("Bearer correct-hors", 401, "not the token"),
        ("Bearer correct-horse2", 401, "not the token"),
        ("Bearer \xfc", 401, "not the token"),
    ],
)
def test_who_has_it_not_is_refused_and_recorded(authorization: str, status: int, words: str) -> None:
    """The sentence holds neither token."""
    refused = gate().refusal("10.0.0.1", authorization)
    assert refused is not None
    assert (refused.status, refused.is_recorded) == (status, True)
    assert words in refused.sentence
    assert "horse" not in refused.sentence


def test_without_a_token_nobody_is_admitted() -> None:
    """An empty one least of all."""
    refused = gate(token=None).refusal("10.0.0.1", "Bearer ")
    assert refused is not None
    assert (refused.status, refused.is_recorded) == (403, True)


def test_guessing_is_limited_and_does_not_fill_the_table() -> None:
    """Ten wrong ones a minute from one address; then the right one is refused too, and nothing is recorded."""
    clock = ManualClock()
    one = gate(clock=clock)
    wrong = [one.refusal("10.0.0.1", f"Bearer guess-{n}") for n in range(WRONG_PER_MINUTE + 5)]
    right = one.refusal("10.0.0.1", "Bearer correct-horse")

    assert [refused and refused.status for refused in wrong] == [401] * WRONG_PER_MINUTE + [429] * 5
    assert right is not None
    assert (right.status, right.is_recorded) == (429, False)
    assert one.refusal("10.0.0.2", "Bearer correct-horse") is None
    clock.sleep(60)
    assert one.refusal("10.0.0.1", "Bearer correct-horse") is None


def test_the_addresses_that_are_counted_are_bounded() -> None:
    """Of a network with many."""
    one = gate()
    for n in range(MOST_ADDRESSES + 50):
        one.refusal(f"fd00::{n:x}", "Bearer guess")
    assert len(one._wrong._rates) <= MOST_ADDRESSES
