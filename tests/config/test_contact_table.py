"""The settings of contact that a configuration may change."""

from edge.config import ContactTable
from edge.core.contact.settings import ContactSettings


def test_the_defaults_are_the_rules_own() -> None:
    own = ContactSettings()
    assert ContactTable().model_dump() == {name: getattr(own, name) for name in ContactTable.model_fields}


def test_the_configuration_reaches_the_rules() -> None:
    settings = ContactTable(settle_s=0.4, light_levels=5.0).settings(is_external=True)
    assert (settings.settle_s, settings.light_levels, settings.is_external) == (0.4, 5.0, True)
