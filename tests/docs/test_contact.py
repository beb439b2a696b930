"""The page about contact names every setting, with the default that the program has."""

from pathlib import Path

from edge.config import ContactTable
from edge.core.contact.settings import ContactSettings
from edge.core.contact.table import Signal

PAGE = (Path(__file__).parents[2] / "docs" / "contact.md").read_text(encoding="utf-8")


def test_every_setting_is_explained_with_its_default() -> None:
    """Those of the configuration, and they are the program's own."""
    rows = [line.split("|") for line in PAGE.splitlines() if line.startswith("| `")]
    shown = {row[1].strip(" `"): float(row[2]) for row in rows}
    assert shown == ContactTable().model_dump()
    own = ContactSettings()
    assert shown == {name: getattr(own, name) for name in ContactTable.model_fields}


def test_every_signal_is_explained() -> None:
    assert [signal for signal in Signal if f"\n| {signal} |" not in PAGE] == []


def test_the_configuration_reaches_the_rules() -> None:
    settings = ContactTable(settle_s=0.4, light_levels=5.0).settings(is_external=True)
    assert (settings.settle_s, settings.light_levels, settings.is_external) == (0.4, 5.0, True)
