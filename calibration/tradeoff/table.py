"""The front of a run as lines of text."""

from collections.abc import Sequence

from calibration.tradeoff.rows import Row

__all__ = ["table"]


def table(rows: Sequence[Row]) -> str:
    """One line per point on the front, fastest first."""
    front = sorted((row for row in rows if row["is_on_front"]), key=lambda row: float(row["ms"]["median"]))
    width = max((len(row["key"]) for row in front), default=5)
    lines = [
        f"{'on the front':<{width}}  {'AU-PRO':>7} {'interval':>14} {'ms':>8} {'p95':>8} {'floor':>7} {'bank MB':>8}"
    ]
    return "\n".join([*lines, *(_line(row, width) for row in front)])


def _line(row: Row, width: int) -> str:
    accuracy, ms = row["accuracy"]["aupro_fpr01"], row["ms"]
    interval = "-" if accuracy["low"] is None else f"{accuracy['low']:.3f} to {accuracy['high']:.3f}"
    value = "-" if accuracy["value"] is None else f"{accuracy['value']:.3f}"
    return (
        f"{row['key']:<{width}}  {value:>7} {interval:>14} {ms['median']:>8.1f} {ms['p95']:>8.1f} "
        f"{row['floor']['ms']:>7.1f} {row['bank_bytes'] / 1e6:>8.2f}"
    )
