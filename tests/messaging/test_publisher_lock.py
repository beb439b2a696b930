"""One process publishes from a database, by whatever name it calls the file."""

import os
from pathlib import Path

import pytest

from edge.core.errors import StoreError
from edge.messaging.publisher import PublisherLock
from edge.store.press_store import Store


def test_a_symbolic_link_is_the_same_database(path: Path, tmp_path: Path) -> None:
    """The lock is on the file that the link leads to."""
    Store(path).close()
    (tmp_path / "other").mkdir()
    link = tmp_path / "other" / "link.db"
    link.symlink_to(path)
    lock = PublisherLock(path)

    with pytest.raises(StoreError, match="another gelgate process publishes"):
        PublisherLock(link)

    lock.close()
    PublisherLock(link).close()


def test_a_second_hard_link_is_refused(path: Path, tmp_path: Path) -> None:
    """Two names are two journals of one file, which SQLite cannot bear."""
    Store(path).close()
    os.link(path, tmp_path / "second.db")

    for name in (path, tmp_path / "second.db"):
        with pytest.raises(StoreError, match="has 2 names"):
            PublisherLock(name)

    (tmp_path / "second.db").unlink()
    PublisherLock(path).close()
