"""Parameters of every method: what is refused, in one sentence, and what a published defect adds."""

import json
import re
from pathlib import Path

import pytest

from edge import registry
from edge.core.errors import FitError
from plugins.detectors.common.parameters import Parameters

METHODS = ("padim", "spade", "fapm", "inreach", "patchcore", "subspace")
DETECTORS = Path(__file__).resolve().parents[2] / "plugins" / "detectors"
OWN = ("padim", "spade", "fapm", "inreach")


@pytest.mark.parametrize(
    ("method", "overrides", "says"),
    [
        ("padim", {"rank": [1]}, "padim: 'rank' is [1]: Input should be a valid integer"),
        (
            "padim",
            {"rank": "abc"},
            "padim: 'rank' is 'abc': Input should be a valid integer, unable to parse",
        ),
        ("spade", {"dims": 31}, "spade: 'dims' is 31: expected a list, such as [1, 2]"),
        ("spade", {"layers": "layer1"}, "spade: 'layers' is 'layer1': expected a list, such as [1, 2]"),
        ("inreach", {"is_fallbak": True}, "inreach: 'is_fallbak' is not known; did you mean 'is_fallback'?"),
        ("fapm", {"pooling": 2}, "fapm: pooling is an odd number of cells, found 2"),
        ("fapm", {"layers": []}, "fapm: 'layers' is []: "),
        ("patchcore", {"sigma": float("inf")}, "patchcore: 'sigma' is inf: Input should be a finite number"),
        ("subspace", {"variance": 2}, "subspace: 'variance' is 2: Input should be less than or equal to 1"),
    ],
)
def test_nonsense_is_one_sentence(method: str, overrides: dict[str, object], says: str) -> None:
    """The method, the name, what was found and what is expected; an unknown name with the nearest known one."""
    with pytest.raises(FitError) as refused:
        registry.detector(method).parameters(**overrides)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_faults_are_one_report() -> None:
    """Both names, so that one try is enough."""
    with pytest.raises(FitError, match=r"'ridge' is -1: .*; 'rank' is 0: "):
        registry.detector("padim").parameters(rank=0, ridge=-1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mode", ["paper", "corrected"])
def test_parameters_are_plain_values(method: str, mode: str) -> None:
    """The parameters of a manifest give the same parameters again; they cannot be changed."""
    p = registry.detector(method).parameters(mode)
    assert isinstance(p, Parameters)
    assert p.mode == mode
    written = json.loads(json.dumps(vars(p)))
    del written["mode"]
    assert registry.detector(method).parameters(mode, **written) == p
    with pytest.raises(ValueError, match="frozen"):
        p.sigma = 1.0  # type: ignore[attr-defined]


@pytest.mark.parametrize("method", METHODS)
def test_every_parameter_says_what_it_is(method: str) -> None:
    """One sentence without a full stop, which docs/parameters.md prints."""
    for name, field in type(registry.detector(method).parameters("paper")).model_fields.items():
        assert field.description, f"{method}: {name} has no description"
        assert "\n" not in field.description
        assert not field.description.endswith(".")


@pytest.mark.parametrize("method", OWN)
def test_the_corrected_parameters_know_no_published_defect(method: str) -> None:
    """Only the published variant has the switches of published defects, and they are off unless named."""
    detector = registry.detector(method)
    corrected, published = type(detector.parameters()), type(detector.parameters("paper"))
    defects = published.model_fields.keys() - corrected.model_fields.keys()
    assert defects
    assert issubclass(published, corrected)
    for name in defects:
        p = detector.parameters(**{name: published.model_fields[name].default})
        assert type(p) is published
        assert {key: value for key, value in p if key not in defects} == dict(detector.parameters())


@pytest.mark.parametrize("method", OWN)
def test_a_method_reads_without_its_published_defects(method: str) -> None:
    """In a method's folder only paper.py names a switch of a published defect."""
    detector = registry.detector(method)
    corrected, published = type(detector.parameters()), type(detector.parameters("paper"))
    defects = published.model_fields.keys() - corrected.model_fields.keys()
    files = [file for file in (DETECTORS / method).glob("*.py") if file.name != "paper.py"]
    assert len(files) >= 4
    for file in files:
        words = set(re.findall(r"\w+", file.read_text(encoding="utf-8")))
        assert not words & defects, file.name
