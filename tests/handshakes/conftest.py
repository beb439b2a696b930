"""The standard's nodes of OPC UA servers, built at the first start of a session alone."""

import gc
import shelve
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="session", autouse=True)
def kept_nodes() -> Iterator[None]:
    """Keep them pickled, as asyncua keeps them for slow devices: a server has those that it reads, of six thousand.
    All of them cost a second and a half of each start, half of it as garbage after its end."""
    from asyncua.server import address_space
    from asyncua.server.internal_server import InternalServer

    build, pickled = InternalServer.load_standard_address_space, dict[str, bytes]()

    async def load(server: Any, shelf: None = None) -> None:
        if not pickled:
            gc.disable()
            await build(server)
            gc.enable()
            server.aspace.make_aspace_shelf(Path())
        server.aspace.load_aspace_shelf(Path())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InternalServer, "load_standard_address_space", load)
        patch.setattr(address_space.shelve, "open", lambda *_, **__: shelve.Shelf(pickled))
        yield
