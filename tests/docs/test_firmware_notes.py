"""Each device has its facts, and each fact says how it is known."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "firmware_notes").glob("*.md"))
WITHOUT_A_DEVICE = {"recorded", "usb_mock", "virtual_overview", "virtual_hid"}
EVIDENCE = re.compile(r"(seen|measured|read|assumed)\b")


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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_fact_says_how_it_is_known(page: Path) -> None:
    """The last cell of each row begins with the kind of evidence."""
    rows = [
        line.rstrip("| ").rpartition("|")[2].strip()
        for line in page.read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    cells = [cell for cell in rows if cell != "how known" and cell.strip("-")]

    assert [cell for cell in cells if not EVIDENCE.match(cell)] == []
    assert len(cells) >= 5
