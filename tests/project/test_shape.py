"""The limits of the source's shape: no circle of imports, no function of more than 59 lines, no file above 400."""

import importlib.util
import sys
from pathlib import Path
from textwrap import dedent

import pytest

ROOT = Path(__file__).resolve().parents[2]
_spec = importlib.util.spec_from_file_location("measure", Path(__file__).with_name("measure.py"))
assert _spec is not None
assert _spec.loader is not None
measure = importlib.util.module_from_spec(_spec)
sys.modules["measure"] = measure
_spec.loader.exec_module(measure)

MAX_FUNCTION_LINES = 59
MAX_FILE_LINES = 400


@pytest.fixture(scope="module")
def shape() -> "measure.Shape":
    return measure.measure(ROOT)


def test_no_module_imports_itself_through_others(shape: "measure.Shape") -> None:
    """Imports inside functions count: a module can be read without reading those that need it."""
    assert measure.circle(shape.imports) == ()


def test_no_room_imports_itself_through_others(shape: "measure.Shape") -> None:
    """Rooms can be put in an order in which each needs only earlier ones."""
    assert measure.circle(shape.rooms) == ()


def test_functions_fit_in_the_eye(shape: "measure.Shape") -> None:
    """None has 60 lines."""
    assert [one for one in shape.functions if one.lines > MAX_FUNCTION_LINES] == []


def test_files_have_one_subject(shape: "measure.Shape") -> None:
    """A file above 400 lines has two."""
    assert {file: lines for file, lines in shape.files.items() if lines > MAX_FILE_LINES} == {}


def test_the_measure_sees_circles_and_lengths(tmp_path: Path) -> None:
    """On a small tree: an import in a function closes a circle, a docstring is not counted, a decorator neither."""
    for name, text in {
        "edge/a/one.py": "from edge.b import two\n",
        "edge/b/two.py": "def f() -> None:\n    from edge.a.one import x\n",
        "edge/c.py": '''
            import edge.b.two

            @property
            def f() -> int:
                """Two
                lines."""
                return 1
            ''',
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(dedent(text).lstrip())
    shape = measure.measure(tmp_path)

    assert set(measure.circle(shape.imports)) == {"edge/a/one.py", "edge/b/two.py"}
    assert set(measure.circle(shape.rooms)) == {"edge/a", "edge/b"}
    assert shape.rooms["edge/c.py"] == {"edge/b"}
    assert {one.name: one.lines for one in shape.functions} == {"edge/b/two.py:f": 2, "edge/c.py:f": 2}
