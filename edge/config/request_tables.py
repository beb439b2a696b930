"""The tables of what others may ask of a station: requests, what people say of presses, and counters."""

from pathlib import Path

from pydantic import Field, model_validator

from edge.config.plugin_tables import Table

__all__ = ["CommandTable", "ConfirmTable", "MetricsTable"]


class ConfirmTable(Table):
    """What people are asked about, where `confirm_press` is served: see operations.md."""

    questions_per_day: int = Field(
        default=10,
        ge=0,
        le=100,
        description="presses that a person is asked about on one day, at most; 0: none",
    )


class MetricsTable(Table):
    """Counters for Prometheus, on this machine alone: http://127.0.0.1:<port>/metrics. Needs the extra `metrics`."""

    port: int | None = Field(default=None, ge=1024, le=65535, description="TCP port; none: not served")


class CommandTable(Table):
    """Which requests are served, and from whom; all others are refused. mqtt.md has the verbs."""

    unsigned: tuple[str, ...] = Field(
        default=("trigger",),
        description="verbs for everybody whom the broker lets publish on `cmd/<verb>`: its access rules decide",
    )
    signed: tuple[str, ...] = Field(
        default=(),
        description="verbs that need a signature with the secret, such as `relearn` and `replace_gel`",
    )
    secret_file: Path | None = Field(
        default=None, description="file that holds only the secret, at least 16 bytes, rights 0640"
    )
    page: tuple[str, ...] = Field(
        default=("select_part", "begin_piece", "acknowledge_alarm", "replace_gel", "confirm_press"),
        description="verbs for a person at the sink `page` who has its token; without a token none is served there",
    )
    requests_per_minute: int = Field(
        default=60,
        ge=1,
        le=6000,
        description="of signed, unsigned and page requests each, of all verbs together; more are refused",
    )

    @model_validator(mode="after")
    def _secret_for_signed(self) -> "CommandTable":
        if self.signed and self.secret_file is None:
            raise ValueError("signed verbs need secret_file")
        if both := sorted(set(self.signed) & set(self.unsigned)):
            raise ValueError(f"{', '.join(both)}: a verb is signed or unsigned, not both")
        return self
