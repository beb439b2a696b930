"""A picture of another size brought to a profile's: cut to its aspect in the middle, then scaled, never squashed."""

__all__ = ["cut_in_words", "cut_to_aspect"]


def cut_to_aspect(size: tuple[int, int], wanted: tuple[int, int]) -> tuple[float, float]:
    """The fraction that is cut from each side, (x, y), so that (width, height) gets the aspect of `wanted`."""
    width, height = size
    aspect = wanted[0] / wanted[1]
    return (max(0.0, (1 - height * aspect / width) / 2), max(0.0, (1 - width / aspect / height) / 2))


def cut_in_words(size: tuple[int, int], wanted: tuple[int, int]) -> str:
    """Describe what happens to a picture of this size, such as `640x400 cut to 533x400 and scaled to 320x240`."""
    x, y = cut_to_aspect(size, wanted)
    left = (round(size[0] * (1 - 2 * x)), round(size[1] * (1 - 2 * y)))
    cut = "" if left == size else f" cut to {left[0]}x{left[1]} in the middle and"
    return f"{size[0]}x{size[1]}{cut} scaled to {wanted[0]}x{wanted[1]}"
