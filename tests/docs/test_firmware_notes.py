"""Each device has its page, and each fact on it says how it is known."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTES = ROOT / "firmware_notes"
PAGES = sorted(path for path in NOTES.glob("*.md") if path.name != "README.md")
WITHOUT_A_DEVICE = {"recorded", "usb_mock", "virtual_overview", "virtual_hid"}
EVIDENCE = re.compile(r"(seen|measured|read|assumed)\b")


def test_each_plugin_that_speaks_to_a_device_has_a_page() -> None:
    """By its name in the first lines, and in the list; no page is of nothing."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    plugins = {
        name
        for kind in ("devices", "overviews", "triggers", "actuators")
        for name in groups[f"gelgate.{kind}"]
    }
    listed = (NOTES / "README.md").read_text(encoding="utf-8")
    owners = {page.name: re.findall(r"plugin `(\w+)`", page.read_text(encoding="utf-8")) for page in PAGES}

    assert sorted(plugins - WITHOUT_A_DEVICE) == sorted(name for names in owners.values() for name in names)
    for page, (name,) in owners.items():
        assert re.search(rf"\[{page}\].*`{name}`", listed)
    assert [name for name in WITHOUT_A_DEVICE if f"`{name}`" not in listed] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_fact_says_how_it_is_known(page: Path) -> None:
    """The last cell of each row begins with the kind of evidence, and the page says which firmware was seen."""
    text = page.read_text(encoding="utf-8")
    rows = [
        line.rstrip("| ").rpartition("|")[2].strip() for line in text.splitlines() if line.startswith("|")
    ]
    cells = [cell for cell in rows if cell != "how known" and cell.strip("-")]

    assert [cell for cell in cells if not EVIDENCE.match(cell)] == []
    assert len(cells) >= 5
    assert "\n**Firmware: " in text
