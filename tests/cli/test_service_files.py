"""The udev rule and the systemd unit that come with the program agree with it."""

import re
from pathlib import Path

import pytest

from edge.cli import EXIT_CODES
from edge.core.errors import BundleError, ConfigError
from plugins.devices.uvc.identity import PRODUCT_ID, PRODUCT_PREFIX, VENDOR_ID
from plugins.digital_io.dcttech_relay import RELAY_IDS
from plugins.digital_io.hid_pedal import PEDALS

SERVICE = Path(__file__).resolve().parents[2] / "edge/service"


def test_udev_rules_match_the_sensor_and_no_webcam() -> None:
    """Every rule asks for the id and the product string of plugins.devices.uvc.identity."""
    lines = [line for line in rules() if '"hidraw"' not in line]
    assert len(lines) == 3
    for line in lines:
        assert f'{{idVendor}}=="{VENDOR_ID:04x}"' in line
        assert f'{{idProduct}}=="{PRODUCT_ID:04x}"' in line
        assert f'{{product}}=="{PRODUCT_PREFIX}*"' in line


def rules() -> list[str]:
    text = (SERVICE / "60-gelgate.rules").read_text().replace("\\\n", "")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_udev_rules_match_every_known_pedal_and_board() -> None:
    """The ids are those of the drivers; a board by its product, because its id is shared."""
    found = {
        f"{vendor}:{product}": line
        for line in rules()
        if '"hidraw"' in line
        for vendor, products in [re.findall(r'{id(?:Vendor|Product)}=="([0-9a-f|]+)"', line)]
        for product in products.split("|")
    }
    assert set(found) == {*PEDALS, RELAY_IDS}
    assert '{product}=="USBRelay*"' in found[RELAY_IDS]


def test_the_unit_starts_without_a_sensor() -> None:
    """`run` waits for it; nothing is run before that would end with 4 and make systemd start it again for ever."""
    lines = (SERVICE / "gelgate.service").read_text().splitlines()
    commands = [line.partition("=")[2] for line in lines if line.startswith(("ExecStart", "ExecCondition"))]

    assert [command.split()[1:3] for command in commands] == [["run", "--wait-for-device"]]


def test_the_unit_reloads_by_the_signal_that_the_gateway_serves() -> None:
    """`systemctl reload` opens the bundles again."""
    assert "ExecReload=/bin/kill -HUP $MAINPID" in (SERVICE / "gelgate.service").read_text().splitlines()


def test_the_unit_and_the_printed_example_fit(tmp_path: Path) -> None:
    """The example's relative database is below a folder that the unit may write."""
    from edge.cli.run import example
    from edge.config import load_config

    unit = (SERVICE / "gelgate.service").read_text()
    (state,) = re.findall(r"--state-dir (\S+)", unit)
    (folder,) = re.findall(r"^StateDirectory=(.*)$", unit, re.MULTILINE)
    path = tmp_path / "gelgate.toml"
    path.write_text(example())

    assert load_config(path, Path(state)).store.path == Path("/var/lib") / folder / "gelgate.db"
    assert load_config(path).store.path == tmp_path / "gelgate.db"


def test_the_unit_expects_the_reports_that_the_gateway_sends() -> None:
    """Ready, and alive often enough; nobody else of the group may read what it writes; a bundle's first run that fills
    the memory does not stop it."""
    unit = (SERVICE / "gelgate.service").read_text().splitlines()

    assert {"Type=notify", "WatchdogSec=60", "UMask=0027", "MemoryMax=4G", "OOMPolicy=continue"} <= set(unit)


@pytest.mark.parametrize("error", [ConfigError, BundleError])
def test_the_unit_does_not_restart_what_cannot_be_mended(error: type[Exception]) -> None:
    """The exit codes of a wrong configuration or bundle are those that the unit excepts from restarting."""
    (codes,) = re.findall(
        r"^RestartPreventExitStatus=(.*)$", (SERVICE / "gelgate.service").read_text(), re.MULTILINE
    )
    assert str(dict(EXIT_CODES)[error]) in codes.split()
