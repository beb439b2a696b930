"""What every measurement says besides: the kind of processor that it is of."""

import pytest
from emulated_processor import processor_kind


@pytest.fixture(scope="session", autouse=True)
def _kind_of_processor() -> None:
    print(f"\nmeasured on {processor_kind()}")
