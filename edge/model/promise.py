"""The guarantee of a threshold in words: on average over bundles, and for this bundle."""

from edge.model.manifest import ThresholdEntry

__all__ = ["GIVEN", "promise"]

GIVEN = "given by hand"
"""The method of a threshold that no press was asked for."""


def promise(limit: ThresholdEntry) -> str:
    """Say in one or two sentences which rate of false alarms the limit promises."""
    if not limit.n:
        is_given = limit.method == GIVEN
        return f"no rate is promised: the threshold {'was given' if is_given else f'is {limit.method}'}"
    rate = f"at most {_percent(limit.alpha)}"
    if limit.is_floored:
        floor = f"{_percent(limit.alpha_floor)} (1 in {round(1 / limit.alpha_floor)})"
        rate = f"at best {floor}, not the {_percent(limit.alpha)} asked for,"
    whole = f"{_press_count(limit)}: {rate} of {_whom(limit)} fail, on average over bundles"
    return f"{whole}{_of_this_bundle(limit)}"


def _of_this_bundle(limit: ThresholdEntry) -> str:
    """Bundles of older versions have a range, or nothing."""
    press, piece = limit.by_press, limit.by_piece
    if press is not None:
        presses = f"{_percent(press.rate)} of {'presses' if piece is None else 'presses of these pieces'}"
        most = presses if piece is None else f"{_percent(piece.rate)} of new pieces and {presses}"
        return f"; with this bundle at most {most}, {100 * press.confidence:.0f} % sure"
    if limit.rate_range is not None:
        low, high = map(_percent, limit.rate_range)
        return f"; of this bundle alone {low} to {high} (95 %)"
    return ""


def _press_count(limit: ThresholdEntry) -> str:
    presses = f"{limit.n} presses"
    return presses if limit.pieces in (None, limit.n) else f"{presses} of {_pieces(limit.pieces)}"


def _whom(limit: ThresholdEntry) -> str:
    return "sound presses" if limit.pieces in (None, limit.n) else "sound presses of new pieces"


def _pieces(count: int | None) -> str:
    return f"{count} piece{'' if count == 1 else 's'}"


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"
