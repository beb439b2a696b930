"""The standard's nodes of OPC UA servers, built at the first start of a session alone."""

import gc
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="session", autouse=True)
def kept_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep them as asyncua keeps them in a file, and look for no garbage among them: three seconds of each start."""
    from asyncua.server.internal_server import InternalServer

    build, kept = InternalServer.load_standard_address_space, tmp_path_factory.mktemp("nodes") / "standard"

    async def load(server: Any, shelf: None = None) -> None:
        gc.disable()
        if kept.is_file():
            server.aspace.load(kept)
        else:
            await build(server)
            server.aspace.dump(kept)
        gc.enable()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InternalServer, "load_standard_address_space", load)
        yield
