"""Linear algebra uses one thread in the long parts, in every environment."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
import tiny
from threadpoolctl import threadpool_info, threadpool_limits
from tiny_fit import config, presses

from calibration.evaluate.scoring import evaluate_bundle
from calibration.fitting.fit import fit_files
from calibration.threads import one_blas_thread
from edge.model.bundle_writer import write_bundle
from export.finish import WrapConfig, wrap_files


def threads() -> int:
    """Of the library of linear algebra that may use the most."""
    return max(pool["num_threads"] for pool in threadpool_info())


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    """What an environment allows by default on a machine of two cores."""
    with threadpool_limits(limits=2):
        assert threads() == 2
        yield


def during(work: Callable[[Callable[[str, float], None]], object]) -> set[int]:
    """The threads allowed at every report of progress."""
    seen: set[int] = set()
    work(lambda stage, fraction: seen.add(threads()))
    assert threads() == 2  # given back afterwards
    return seen


PRESSES = presses(12)


def test_fit_uses_one() -> None:
    """From the features to the golden frames."""
    assert during(lambda report: fit_files(PRESSES, config(), created="2026-01-01", report=report)) == {1}


def test_wrap_uses_one() -> None:
    """A foreign graph is scored by the runtime, its threshold by NumPy."""
    import onnx.parser

    graph = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 17] >
        theirs (uint8[n, h, w, 3] frames) => (float[n, h, w] score_map, float[n] score)
        {
            pixels = Cast <to = 1> (frames)
            score_map = ReduceMean <axes = [3], keepdims = 0> (pixels)
            score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
        }
    """).SerializeToString()
    wrap = WrapConfig("bolt", "top", tiny.PROFILE, tiny.REGION, "theirs")

    assert during(lambda report: wrap_files(graph, PRESSES, wrap, created="2026-01-01", report=report)) == {1}


def test_evaluate_uses_one(tmp_path: Path) -> None:
    """While it scores; the metrics are under the same limit."""
    bundle = write_bundle(tmp_path / "tiny", tiny.tiny_files()[1])
    good = tmp_path / "bolt" / "test" / "good"
    good.mkdir(parents=True)
    cv2.imwrite(str(good / "bolt_test_s001_p01.png"), np.full((40, 48, 3), 120, np.uint8))
    seen: set[int] = set()

    @contextmanager
    def show(what: str, total: int) -> Iterator[Callable[[int], None]]:
        seen.add(threads())
        yield lambda done: seen.add(threads())

    evaluate_bundle(
        bundle, tmp_path / "bolt", part="*", position="*", limit=0.01, replicates=0, seed=0, show=show
    )

    assert seen == {1}
    assert threads() == 2


@one_blas_thread()
def failing() -> None:
    assert threads() == 1
    raise ZeroDivisionError


def test_the_limit_ends_with_what_it_was_put_around() -> None:
    """Also after an error."""
    with pytest.raises(ZeroDivisionError):
        failing()
    assert threads() == 2
