"""The base of every table of the configuration, and the table that chooses one plugin."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["PluginTable", "Table"]


class Table(BaseModel):
    """Frozen; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PluginTable(Table):
    """One plugin, chosen by name."""

    plugin: str = Field(description="its name")
    options: dict[str, Any] = Field(default_factory=dict, description="the options of that plugin")
