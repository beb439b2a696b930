"""Where the page is served, to whom, and with which token, by the sink `page` and by `gelgate station page`."""

import os
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, model_validator

from edge.config.loading import read_secret
from edge.core.errors import ConfigError
from edge.page.access import Access

__all__ = ["PageSettings"]

# Guessing is limited to some tries a minute, and a person has to type it.
SHORTEST_TOKEN: Final = 8

HostName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?$")]


def _own_address(text: str) -> str:
    """Check an address of this machine. Errors: ValueError."""
    try:
        return str(ip_address(text))
    except ValueError:
        raise ValueError(
            "expected an address of this machine, such as 127.0.0.1 or 0.0.0.0 for all"
        ) from None


def _network(text: str) -> str:
    """Check an address or a network. Errors: ValueError."""
    try:
        return str(ip_network(text))
    except ValueError as error:
        raise ValueError(f"expected an address or a network, such as 192.168.1.0/24: {error}") from None


class PageSettings(BaseModel):
    """Where the page is: by default http://127.0.0.1:<port>/, for a browser on this machine, and nothing can be changed
    with it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: int = Field(default=8080, ge=1024, le=65535, description="TCP port")
    bind: Annotated[str, AfterValidator(_own_address)] = Field(
        default="127.0.0.1", description="the address of this machine to listen on; `0.0.0.0` for all"
    )
    allow_from: tuple[Annotated[str, AfterValidator(_network)], ...] = Field(
        default=(),
        description="other machines that may see the page, such as `192.168.1.20` or `192.168.1.0/24`; needs `bind`",
    )
    names: tuple[HostName, ...] = Field(
        default=(), description="names of this machine in the browser's address line, besides its address"
    )
    token_file: Path | None = Field(
        default=None,
        description="file that holds only the token for changes, at least 8 bytes, rights 0640; none: the page only "
        "shows",
    )
    token_variable: str | None = Field(
        default=None,
        min_length=1,
        max_length=128,
        description="name of the environment variable that holds the token, instead of a file",
    )

    manual: Path | None = Field(
        default=None,
        description="folder of the manual, made by `gelgate station docs --site`; the page links to it",
    )

    @model_validator(mode="after")
    def _can_work(self) -> Self:
        is_open = not ip_address(self.bind).is_loopback
        if is_open and not self.allow_from:
            raise ValueError(
                f"bind = '{self.bind}' needs allow_from: name the machines that may see the page, such as "
                "192.168.1.0/24"
            )
        if self.allow_from and not is_open:
            raise ValueError(
                f"allow_from needs bind: no other machine reaches {self.bind}; name an address of this machine, or "
                "0.0.0.0"
            )
        if self.token_file is not None and self.token_variable is not None:
            raise ValueError("the token is in token_file or in token_variable, not in both")
        return self

    def access(self) -> Access:
        """Who may see it."""
        return Access(tuple(map(ip_network, self.allow_from)), self.names)

    def token(self) -> bytes | None:
        """Read the token, None without one. Errors: ConfigError for one that cannot be read, or is too short."""
        if self.token_file is not None:
            return read_secret(self.token_file, "token_file", SHORTEST_TOKEN)
        if self.token_variable is None:
            return None
        token = os.environ.get(self.token_variable, "").strip().encode()
        if len(token) < SHORTEST_TOKEN:
            raise ConfigError(
                f"token_variable: the environment variable {self.token_variable} holds {len(token)} bytes, at least "
                f"{SHORTEST_TOKEN} are needed"
            )
        return token

    def warnings(self) -> list[str]:
        """Say what is open to others. Errors: ConfigError for a token that cannot be used."""
        has_token, sentences = self.token() is not None, []
        if self.manual is not None and not (self.manual / "index.html").is_file():
            sentences.append(f"no manual is in {self.manual}; `gelgate station docs --site` makes it")
        if not ip_address(self.bind).is_loopback:
            way = ": its token can be read on the way; set bind to 127.0.0.1 behind a proxy with TLS"
            sentences.append("the page is not encrypted on the network" + (way if has_token else ""))
        return sentences
