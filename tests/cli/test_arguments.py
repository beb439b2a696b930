"""`--set` and `--option` read their values in the same way."""

import pytest

from edge.cli.arguments import parse_values
from edge.core.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("n=3", 3),
        ("n=2.5", 2.5),
        ("n=1e-3", 1e-3),
        ("n=true", True),
        ("n=[1, 2]", [1, 2]),
        ('n="3"', "3"),
        ('n=["drop@3"]', ["drop@3"]),
        ("n=int8", "int8"),
        ("n=a=b", "a=b"),
        ("n=", ""),
        ("n=2026-11-21", "2026-11-21"),
        ("n=/a folder/file", "/a folder/file"),
    ],
)
def test_a_value_is_toml_or_else_text(text: str, value: object) -> None:
    """Numbers, truth values, quoted texts and lists as TOML writes them; everything else, dates too, is text."""
    found = parse_values("--set", [text])

    assert found == {"n": value}
    assert type(found["n"]) is type(value)


@pytest.mark.parametrize("text", ["gain", "=3", "two words=3"])
@pytest.mark.parametrize("option", ["--set", "--option"])
def test_a_text_without_name_or_sign_is_refused(option: str, text: str) -> None:
    with pytest.raises(ConfigError, match=f"'{option} {text}' is not understood; write {option} name=value"):
        parse_values(option, [text])
