"""A receiver's address is tried before the start."""

import pytest

from edge.config import PluginTable
from edge.core.errors import ConfigError
from edge.gateway.preflight import _reachable


@pytest.mark.parametrize("host", ["broker..plant", "x" * 70 + ".plant"])
def test_a_name_that_no_host_can_have_is_a_sentence(host: str) -> None:
    """Python refuses to look such a name up with an error of its own kind."""
    with pytest.raises(ConfigError, match=r"cannot be the name of a host; correct sinks\.1\.options\.host"):
        _reachable(PluginTable(plugin="mqtt", options={"host": host}), "sinks.1")
