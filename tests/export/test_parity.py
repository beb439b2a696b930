"""A comparison names the first stage that differs, with its numbers, and refuses."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy

from edge.core.errors import BundleCorrupt
from export.parity import ORDER_LEAST, TOLERANCES, Stage, compare, order_stage, rank_correlation

RNG = np.random.default_rng(0)
TAP = RNG.normal(size=(2, 3, 4, 4)).astype(np.float32)
MAPS = RNG.random((2, 8, 8)).astype(np.float32)


def test_equal_stages_pass() -> None:
    """Rounding of float32 is within every tolerance."""
    report = compare([Stage("layer1", TAP, TAP * (1 + 1e-6)), Stage("map", MAPS, MAPS, "map")])
    report.raise_if_different()
    assert report.is_equal
    assert report.first_different is None


def test_the_first_stage_that_differs_is_named_with_its_numbers() -> None:
    """Stages before it are listed as equal; later differences follow from it and are not blamed."""
    other = TAP.copy()
    other[1, 2, 3, 0] += 5
    report = compare(
        [Stage("input", TAP, TAP, "input"), Stage("layer2", TAP, other), Stage("map", MAPS, 2 * MAPS, "map")]
    )
    with pytest.raises(
        BundleCorrupt, match=r"stage 'layer2'.*\(1, 2, 3, 0\).*equal before it: input\)"
    ) as caught:
        report.raise_if_different()
    assert f"found {other[1, 2, 3, 0]:.6g}" in str(caught.value)
    assert [result.is_equal for result in report.results] == [True, False, False]


def test_the_tolerance_is_relative_to_the_largest_value() -> None:
    """A thousand times larger values may differ a thousand times as much."""
    assert compare([Stage("a", 1000 * TAP, 1000 * TAP + 1e-2)]).is_equal
    assert not compare([Stage("a", TAP, TAP + 1e-2)]).is_equal
    assert compare([Stage("a", TAP, TAP + 1e-2, tolerance=0.1)]).is_equal


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (TAP[:, :, :2], "has shape"),
        (np.full_like(TAP, np.nan), "the bundle that are not finite"),
        (np.full_like(TAP, "x", dtype=object), "not finite numbers"),
    ],
)
def test_what_cannot_be_compared_differs(found: np.ndarray, words: str) -> None:
    """Another shape, NaN or objects never count as equal."""
    with pytest.raises(BundleCorrupt, match=words):
        compare([Stage("tap", TAP, found)]).raise_if_different()


def test_no_stage_is_refused() -> None:
    """An empty comparison would always pass."""
    with pytest.raises(ValueError, match="no stage"):
        compare([])


def test_the_order_of_the_presses_is_a_stage() -> None:
    """Scaled scores keep the order; two exchanged neighbours of twenty do not."""
    scores = np.arange(20.0)
    assert compare([order_stage(scores, 3 * scores + 1)]).is_equal
    exchanged = scores.copy()
    exchanged[[4, 5]] = exchanged[[5, 4]]
    result = compare([order_stage(scores, exchanged)]).results[0]
    assert result.difference < ORDER_LEAST
    assert "rank correlation of 20 scores is 0.99" in result.sentence()


def test_scores_that_differ_by_noise_have_no_order() -> None:
    """The float32 of two graphs orders equal presses at random."""
    scores, noise = np.array([1.0, 1.0, 2.0, 2.0]), np.array([0, 3e-8, 3e-8, 0])
    assert compare([order_stage(scores, scores + noise)]).is_equal
    assert not compare([order_stage(scores, scores + 3e6 * noise)]).is_equal


def test_rank_correlation_is_spearmans() -> None:
    """As scipy computes it, ties included."""
    a, b = RNG.integers(0, 6, 40), RNG.normal(size=40)
    assert rank_correlation(a, b) == pytest.approx(scipy.stats.spearmanr(a, b).statistic)
    assert rank_correlation(np.ones(4), np.ones(4)) == 1
    assert rank_correlation(np.ones(4), np.arange(4)) == 0


def test_the_report_is_one_page_with_both_maps(tmp_path: Path) -> None:
    """One file without links; per frame: the picture, both maps, their difference. Names are escaped."""
    frames = np.full((2, 8, 8, 3), 90, np.uint8)
    stages = [Stage("<layer1>", TAP, TAP), Stage("map", MAPS, MAPS + 1, "map")]
    path = compare(stages, frames=frames, title="bolt", facts={"model": "a & b"}).write(tmp_path / "new")
    text = path.read_text()
    assert len(re.findall(r"<img ", text)) == 2 * 4
    assert not re.search(r"https?://|<script", text)
    assert "&lt;layer1&gt;" in text
    assert "a &amp; b" in text
    assert "First difference: stage &#x27;map&#x27;" in text
    assert [file.name for file in path.parent.iterdir()] == ["parity.html"]


def test_the_manual_has_the_tolerances_of_the_program() -> None:
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([a-z, ]+) \| (\d+e-\d+) \|$", page, re.MULTILINE)

    found = {kind: float(value) for kinds, value in rows for kind in kinds.replace("taps", "tap").split(", ")}
    assert found == TOLERANCES
