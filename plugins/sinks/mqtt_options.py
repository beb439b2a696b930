"""The options of the MQTT sink."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, model_validator

from edge.core.errors import SinkRejected
from edge.core.sink_context import topic_level
from edge.messaging.command_payloads import LARGEST_REQUEST_BYTES
from edge.messaging.mqtt_broker import Broker, LoginRefused, read_password, tls_context
from edge.messaging.mqtt_connection import Connection

__all__ = ["LARGEST_PACKET_BYTES", "BrokerOptions", "MqttOptions", "TlsOptions", "TopicLevel"]

# The packet has room for a request that is a little too large, so that it gets an answer and not silence.
LARGEST_PACKET_BYTES: Final = 2 * LARGEST_REQUEST_BYTES

# How long a check waits for a broker that says nothing.
TRIAL_S: Final = 2.0

_OWN_MACHINE: Final = ("localhost", "127.0.0.1", "::1")

# A control character is refused by brokers, and shows as nothing in a log.
TopicLevel = Annotated[str, AfterValidator(topic_level)]

PlainText = Annotated[str, StringConstraints(min_length=1, max_length=256, pattern=r"^[^\x00-\x1f\x7f]*$")]


class TlsOptions(BaseModel, extra="forbid", frozen=True, allow_inf_nan=False):
    """The files of an encrypted connection; an empty table trusts the system's certificate authorities."""

    ca: Path | None = Field(
        default=None,
        description="PEM of the certificate authorities to trust; those of the system by default",
    )
    cert: Path | None = Field(default=None, description="PEM of this gateway's certificate, for mutual TLS")
    key: Path | None = Field(default=None, description="PEM of the key, if it is not in `cert`")

    @model_validator(mode="after")
    def _key_with_cert(self) -> Self:
        if self.key is not None and self.cert is None:
            raise ValueError("key needs cert; name both files")
        return self


class BrokerOptions(BaseModel):
    """Where the broker is. The password is in a separate file, so that the configuration can be shown."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    host: PlainText = Field(default="localhost", description="the broker's name or address")
    port: int | None = Field(default=None, ge=1, le=65535, description="by default 1883, or 8883 with TLS")
    protocol: Literal["auto", "5", "3.1.1"] = Field(
        default="auto",
        description="MQTT level; auto: 5, or 3.1.1 if the broker proves that it does not support 5. A plant sets `5`",
    )
    client_id: PlainText | None = Field(
        default=None, description="unique in the plant; made from the station's names by default"
    )
    username: PlainText | None = Field(default=None, description="user name for the broker")
    password_file: Path | None = Field(default=None, description="file that holds only the password")
    tls: TlsOptions | None = Field(default=None, description="encrypt the connection; a separate table")
    keepalive_s: int = Field(
        default=15, ge=1, le=3600, description="a broker that is silent for 1.5 times this is lost"
    )
    acknowledge_s: float = Field(
        default=10.0, ge=0.01, le=600, description="longest wait for the PUBACK of a message"
    )
    retry_s: float = Field(
        default=30.0, ge=1, le=3600, description="the longest pause between attempts to connect"
    )

    @model_validator(mode="after")
    def _password_with_name(self) -> Self:
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs username; give both")
        return self

    def identity(self) -> str:
        """The receiver: the outbox keeps what it has acknowledged under this name."""
        return "{}:{}".format(*self._address())

    def warnings(self) -> list[str]:
        """List what is open to others on the plant's network."""
        sentences = []
        if self.tls is None and self.host not in _OWN_MACHINE:
            sentences.append("the connection is not encrypted; set tls")
        if (
            self.username is None
            and (self.tls is None or self.tls.cert is None)
            and self.host not in _OWN_MACHINE
        ):
            sentences.append(
                "no user name is given, so others may publish as this station; set username or tls.cert"
            )
        if (
            self.password_file is not None
            and self.password_file.exists()
            and self.password_file.stat().st_mode & 0o007
        ):
            sentences.append(
                f"password file {self.password_file} is open to every user; set its rights to 0640"
            )
        return sentences

    def address(self) -> tuple[str, int]:
        """Give the host and port of the broker. Errors: ConfigError for a password or TLS file that cannot be used."""
        broker = self.broker("check")
        return broker.host, broker.port

    def try_login(self) -> str:
        """Connect as the sink does, with a client id of its own: that of a station that runs would end its connection.
        Errors: SinkRejected where it is refused, SinkUnavailable."""
        broker = self.broker("gelgate")
        trial = replace(
            broker, client_id=f"{broker.client_id}-check", timeout_s=min(broker.timeout_s, TRIAL_S)
        )
        try:
            connection = Connection.open(trial)
        except LoginRefused as error:
            raise SinkRejected(f"{error} (asked as client '{trial.client_id}')") from error
        connection.close()
        return f"{broker} lets this station in, MQTT {connection.level}"

    def broker(self, client_id: str) -> Broker:
        """The broker to connect to. Errors: ConfigError for a password or TLS file that cannot be used."""
        return Broker(
            host=self._address()[0],
            port=self._address()[1],
            client_id=self.client_id or client_id,
            username=self.username,
            password=None if self.password_file is None else read_password(self.password_file),
            tls=None if self.tls is None else tls_context(self.tls.ca, self.tls.cert, self.tls.key),
            keepalive_s=self.keepalive_s,
            timeout_s=self.acknowledge_s,
            level=None if self.protocol == "auto" else self.protocol,
            largest_packet=LARGEST_PACKET_BYTES,
        )

    def _address(self) -> tuple[str, int]:
        return self.host, self.port or (1883 if self.tls is None else 8883)


class MqttOptions(BrokerOptions):
    """Where the broker is, and what a station does there. The password is in a separate file, so that the configuration
    can be shown."""

    home_assistant: TopicLevel | None = Field(
        default=None,
        description="announce the station to Home Assistant below this topic; its own default is `homeassistant`",
    )
    availability: bool = Field(
        default=True,
        description="keep the topic `availability`; its last will needs a second connection, client id "
        "`<client_id>-availability`",
    )
