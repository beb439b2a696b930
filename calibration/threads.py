"""Threads of linear algebra: one. On cores that others use as well, two wait for each other by spinning."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

__all__ = ["one_blas_thread"]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within it, BLAS and OpenMP use one thread; also a decorator. onnxruntime has threads of its own (--threads).

    With four busy processes the same fit of 40 presses took 22 s with one thread, and was not done after 200 s of
    spinning with the default.
    """
    with threadpool_limits(limits=1):
        yield
