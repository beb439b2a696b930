"""What every measurement says besides: the kind of processor that it is of."""

import pytest
from haswell import processor_kind


@pytest.fixture(scope="session", autouse=True)
def _kind_of_processor() -> None:
    print(f"\nmeasured on {processor_kind()}")
