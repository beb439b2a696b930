"""One process per sensor."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from edge.core.errors import DeviceBusy
from plugins.devices.uvc.lock import SensorLock

HOLDER = """
import sys, pathlib
from plugins.devices.uvc.lock import SensorLock
lock = SensorLock("2BNN4ZE7", pathlib.Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_the_second_holder_gets_the_number_of_the_first(tmp_path: Path) -> None:
    """Busy, with the number of the process that has it; free again after close, and closing twice is harmless."""
    lock = SensorLock("2BNN4ZE7", tmp_path)
    with pytest.raises(DeviceBusy, match=f"process {os.getpid()}"):
        SensorLock("2BNN4ZE7", tmp_path)
    lock.close()
    lock.close()
    SensorLock("2BNN4ZE7", tmp_path).close()


def test_other_sensors_are_free(tmp_path: Path) -> None:
    """The lock is the sensor's, not the program's."""
    first, second = SensorLock("2BNN4ZE7", tmp_path), SensorLock("28D8PXEC", tmp_path)
    first.close()
    second.close()


def test_a_killed_process_leaves_no_lock(tmp_path: Path) -> None:
    """Another process holds it; killed, it is free at once."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(DeviceBusy, match=f"process {holder.pid}"):
            SensorLock("2BNN4ZE7", tmp_path)
        holder.kill()
        holder.wait()
    SensorLock("2BNN4ZE7", tmp_path).close()


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    """In a folder that all can write to, nobody may aim the lock at another file."""
    target = tmp_path / "precious"
    target.write_text("kept")
    (tmp_path / "gelgate-2BNN4ZE7.lock").symlink_to(target)
    with pytest.raises(
        DeviceBusy, match=r"2BNN4ZE7\.lock cannot be opened .*; remove it if no other program"
    ):
        SensorLock("2BNN4ZE7", tmp_path)
    assert target.read_text() == "kept"


def test_other_users_see_that_a_service_holds_it(tmp_path: Path) -> None:
    """Whatever its umask: without the right to read the file nobody could take the lock, nor say who has it."""
    before = os.umask(0o077)
    try:
        lock = SensorLock("2BNN4ZE7", tmp_path)
    finally:
        os.umask(before)
    assert lock.path.stat().st_mode & 0o777 == 0o644
    lock.close()
