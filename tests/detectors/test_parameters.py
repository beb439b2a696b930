"""Parameters of every method: what is refused, in one sentence, and what a published defect adds."""

import json

import pytest

from edge import registry
from edge.core.errors import FitError
from plugins.detectors.common.parameters import Parameters

METHODS = ("padim", "spade", "fapm", "inreach", "patchcore", "subspace")
OWN = ("padim", "spade", "fapm", "inreach")


NONSENSE: list[tuple[str, dict[str, object], str]] = [
    ("padim", {"rank": [1]}, "'rank' is [1]: Input should be a valid integer"),
    ("padim", {"rank": "abc"}, "'rank' is 'abc': Input should be a valid integer, unable to parse"),
    ("padim", {"chanels": 5}, "did you mean 'channels'"),
    ("padim", {"ridge": 0.0}, "'ridge' is 0.0: Input should be greater than 0"),
    ("padim", {"ridge": float("nan")}, "'ridge' is nan: Input should be a finite number"),
    ("padim", {"rank": 0}, "'rank' is 0: Input should be greater than or equal to 1"),
    ("padim", {"neighbours": 2}, "'neighbours' is 2: Input should be less than or equal to 1"),
    ("padim", {"sigma_unit": "inch"}, "'sigma_unit' is 'inch': Input should be 'mm' or 'px'"),
    ("padim", {"taps": ()}, "taps must be distinct"),
    ("padim", {"grid_tap": "layer4"}, "not among the taps"),
    ("padim", {"projection": "pca"}, "'projection' is 'pca': Input should be 'all', 'random'"),
    ("padim", {"projection": "random", "channels": None}, "needs channels >= 1"),
    ("padim", {"channel_list": (3, 1)}, "projection=random"),
    ("padim", {"projection": "random", "channel_list": (3, 3)}, "different channel numbers"),
    ("padim", {"projection": "random", "channel_list": (-1, 3)}, "different channel numbers"),
    ("padim", {"rank": 0, "ridge": -1}, "'ridge' is -1: Input should be greater than 0; 'rank' is 0: "),
    ("spade", {"dims": 31}, "'dims' is 31: expected a list, such as [1, 2]"),
    ("spade", {"dims": [1, 2]}, "dims"),
    ("spade", {"layers": "layer1"}, "'layers' is 'layer1': expected a list, such as [1, 2]"),
    ("spade", {"layers": []}, "at least one, found ()"),
    ("spade", {"image_neighbours": 0}, "'image_neighbours' is 0"),
    ("spade", {"cell_mm": -1.0}, "'cell_mm' is -1.0"),
    ("spade", {"is_gallery_whole": False}, "set window_mm=null"),
    ("inreach", {"is_fallbak": True}, "'is_fallbak' is not known; did you mean 'is_fallback'?"),
    ("inreach", {"realisations": 0}, "'realisations' is 0"),
    ("inreach", {"grid_tap": "x"}, "grid_tap"),
    ("inreach", {"upsampling": "cubic"}, "'upsampling' is 'cubic'"),
    ("fapm", {"pooling": 2}, "pooling is an odd number of cells, found 2"),
    ("fapm", {"layers": []}, "'layers' is []: "),
    ("fapm", {"near_fraction": 0}, "'near_fraction' is 0"),
    ("fapm", {"banks": "both"}, "'banks' is 'both'"),
    ("fapm", {"neighbours": 0}, "'neighbours' is 0"),
    ("patchcore", {"sigma": float("inf")}, "'sigma' is inf: Input should be a finite number"),
    ("patchcore", {"coreset_fraction": 0}, "'coreset_fraction' is 0"),
    ("patchcore", {"dims": 0}, "'dims' is 0"),
    ("patchcore", {"grid_tap": "x"}, "grid_tap"),
    ("subspace", {"variance": 2}, "'variance' is 2: Input should be less than or equal to 1"),
    ("subspace", {"variance": 0.0}, "'variance' is 0.0"),
    ("subspace", {"most_rank": 0}, "'most_rank' is 0"),
    ("subspace", {"rank": 3}, "did you mean 'most_rank'"),
    *((method, {"sigma": -1.0}, "'sigma' is -1.0: Input should be greater") for method in METHODS),
]


@pytest.mark.parametrize(("method", "overrides", "says"), NONSENSE)
def test_nonsense_is_one_sentence(method: str, overrides: dict[str, object], says: str) -> None:
    """The method, the name, what was found and what is expected; an unknown name with the nearest known one."""
    with pytest.raises(FitError) as refused:
        registry.detector(method).parameters(**overrides)
    assert str(refused.value).startswith(f"{method}: ")
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


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
