"""Each device has its facts."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "firmware_notes").glob("*.md"))
WITHOUT_A_DEVICE = {"recorded", "usb_mock", "virtual_overview", "virtual_hid"}


def test_each_plugin_that_speaks_to_a_device_has_its_facts_and_firmware() -> None:
    """Under its name, once; and those that speak to none are named."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    plugins = {
        name
        for kind in ("devices", "overviews", "triggers", "actuators")
        for name in groups[f"gelgate.{kind}"]
    }
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    described = re.findall(r"plugin `(\w+)`", text)

    assert sorted(plugins - WITHOUT_A_DEVICE) == sorted(described)
    assert text.count("\n**Firmware: ") == len(described)
    assert [name for name in WITHOUT_A_DEVICE if f"`{name}`" not in text] == []
