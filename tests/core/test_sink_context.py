"""The name of a station at a broker."""

from itertools import pairwise

from edge.core.sink_context import Place


def test_stations_with_other_topics_have_other_names() -> None:
    """A broker disconnects the first of two clients with one name: hyphens and prefixes must not make them equal."""
    places = [
        ("gelgate", "a", "b", "c"),
        ("gelgate", "a-b", "c", "d"),
        ("gelgate", "a", "b-c", "d"),
        ("other", "a", "b", "c"),
        ("third", "a", "b", "c"),
    ]
    names = sorted(Place(*levels, prefix).client_id for prefix, *levels in places)

    assert [one for one, other in pairwise(names) if one == other] == []
    assert names[0] == "gelgate-a-b-c"
