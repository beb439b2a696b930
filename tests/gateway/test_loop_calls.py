"""Requests of other threads to the gateway's loop."""

import threading

import pytest

from edge.core.errors import GelgateError
from edge.gateway.loop_calls import LoopCalls


def test_the_loop_does_what_is_asked_and_the_asker_gets_the_answer() -> None:
    """The answer comes from the thread that serves, and from the state that it passes."""
    calls, answers = LoopCalls[str](), []
    asker = threading.Thread(
        target=lambda: answers.append(calls.ask(lambda name: (name, threading.get_ident())))
    )
    asker.start()
    while asker.is_alive():
        calls.serve("loop")

    assert answers == [("loop", threading.get_ident())]


def test_what_was_refused_is_not_done_later() -> None:
    """A call that was refused is not done afterwards."""
    calls, done = LoopCalls[str](answer_s=0.01), []

    with pytest.raises(GelgateError, match=r"did not answer within 0\.01 s, and has not done it"):
        calls.ask(lambda _: done.append(1))
    calls.serve("loop")

    assert done == []


def test_a_fault_is_the_askers() -> None:
    """It is raised in the caller's thread, and the loop continues."""
    calls, errors = LoopCalls[str](), []

    def fault(_: object) -> None:
        raise ValueError("no such gel")

    def ask() -> None:
        try:
            calls.ask(fault)
        except ValueError as error:
            errors.append(str(error))

    asker = threading.Thread(target=ask)
    asker.start()
    while asker.is_alive():
        calls.serve("loop")

    assert errors == ["no such gel"]


def test_after_the_end_nothing_is_taken() -> None:
    """A call to a loop that has ended does not wait."""
    calls = LoopCalls[str]()
    calls.close("loop")

    with pytest.raises(GelgateError, match="the station is ending"):
        calls.ask(lambda _: None)


def test_a_posted_call_is_done_once_and_not_after_the_end() -> None:
    """Its caller does not wait: a pedal has no one who reads an answer."""
    calls, done = LoopCalls[str](), []
    calls.post(lambda state: done.append(state))
    calls.serve("first")
    calls.serve("second")
    calls.close("end")
    calls.post(lambda state: done.append("late"))
    calls.serve("after")

    assert done == ["first"]
