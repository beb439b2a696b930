"""The feature passes the checks of every feature, and counts."""

from pathlib import Path

from plugins.conformance import check_feature, open_played


def test_it_conforms() -> None:
    """`check_feature` names every fact that does not hold; the package must be installed."""
    check_feature("template")


def test_it_counts_the_presses_of_a_shift(tmp_path: Path) -> None:
    """The second one ends it."""
    with open_played(tmp_path, tables="[feature.template]\ngoal = 2") as station:
        assert station.ask("template") == {}
        station.play()
        assert station.ask("template") == {"shift 1": 3}
        assert station.raised == ["template"]
        entries = [result.feature["template"] for result in station.results]
        assert entries == [{"before": 0}, {"before": 1}, {"before": 2}]
