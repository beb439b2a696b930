"""The detector passes the checks of every detector."""

from plugins.conformance import check_detector

from .detector import plugin


def test_it_conforms() -> None:
    """`check_detector` names every fact that does not hold."""
    check_detector(plugin)
