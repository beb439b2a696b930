"""The sentences of the station, as patterns: of every `Sentence("...")` in the source."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# What is not made of one literal: several that are joined, the texts of errors, which are English, and this module.
NOT_LITERAL = {"'; '.join", "str(error)", "fault", "sensor.fault or "}


@cache
def find_sentences() -> tuple[set[str], set[str]]:
    """Return the patterns, and what else is called a sentence. Examples and checks of plugins have none of the page."""
    patterns, others = set(), set()
    for path in (*(ROOT / "edge").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")):
        if {"templates", "conformance"} & set(path.parts):
            continue
        text = path.read_text(encoding="utf-8")
        for call in ast.walk(ast.parse(text)) if "Sentence(" in text else ():
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Sentence":
                made_of = call.args[0]
                if isinstance(made_of, ast.JoinedStr | ast.Constant):
                    patterns.add(as_pattern(made_of))
                elif not ast.unparse(made_of).startswith(tuple(NOT_LITERAL)):
                    others.add(f"{path.name}: {ast.unparse(made_of)}")
    return patterns, others


def as_pattern(literal: ast.JoinedStr | ast.Constant) -> str:
    """Write each value as its name in braces; of values without a word between them the first."""
    text, names = "", [""]
    for part in literal.values if isinstance(literal, ast.JoinedStr) else [literal]:
        if isinstance(part, ast.Constant):
            text += str(part.value)
        elif isinstance(part, ast.FormattedValue) and not text.endswith("}"):
            names.append(_name(part.value).strip("_").lower())
            count = names.count(names[-1])
            text += f"{{{names[-1]}{f'_{count}' if count > 1 else ''}}}"
    return text


def _name(value: ast.expr) -> str:
    match value:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.Call(func=ast.Name(id="map"), args=[_, of]) | ast.Call(func=_, args=[of]):
            return _name(of)
        case ast.BinOp(left=ast.Constant(), right=of):
            return _name(of)
        case (
            ast.Call(func=of)
            | ast.Subscript(value=of)
            | ast.BinOp(left=of)
            | ast.BoolOp(values=[of, _])
            | ast.IfExp(body=of)
            | ast.GeneratorExp(elt=of)
        ):
            return _name(of)
    raise ValueError(f"this value has no name: {ast.unparse(value)}")
