"""How presses on a new gel are judged by a bundle of the old one, with its shading followed and without.

`python tests/bench/new_gels.py [PART...]` prints the table of docs/gel.md: development parts of `gelgate lab month`, by
default the first ten; of each, eight sound presses and four of damaged or wrong pieces on each of two new gels. Half a
minute of one core a part.
"""

import argparse
import tempfile
from collections import Counter
from pathlib import Path

from calibration.experiments.harness.markdown import markdown_table
from calibration.experiments.month.bundles import fit_first
from calibration.experiments.month.gel import MountedGel
from calibration.experiments.month.plan import Month
from calibration.simulator.reproducible_math import reproducible_opencv
from edge.clock import SystemClock
from edge.core.imaging.decode import decode_view
from edge.core.imaging.frames import CameraFrame
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer

PRESSES, GELS, MOUNTED = 300, (1, 2), 150
"""Of a month; the numbers of the new gels, and of the press before which each is mounted."""


def judge(part: int, bundle: Bundle, gel: int, *, is_followed: bool) -> tuple[Counter[str], Counter[str]]:
    """Count the verdicts on presses of sound pieces, and on those of others."""
    month = Month("development", part, PRESSES)
    mounted, inspector = MountedGel(month, gel, MOUNTED), Inspector(Scorer(bundle), SystemClock())
    sound = [press for day in (16, 17) for press in month.day(day) if press.truth == "sound"][:8]
    others = [press for day in range(30) for press in month.day(day) if press.truth != "sound"][:4]
    free = decode_view(_frame(list(mounted.free(sound[0], 1.0))[-1]), bundle.profile)
    inspector.new_gel = free if is_followed else None
    inspector.follow_light(free)

    def verdict(frames: list[bytes]) -> str:
        return inspector._examine(_frame(frames[len(frames) // 2]), None).word

    counted = [
        Counter(verdict(list(mounted.press(press, 0))) for press in presses) for presses in (sound, others)
    ]
    return counted[0], counted[1]


def _frame(payload: bytes) -> CameraFrame:
    return CameraFrame(payload, 0, 0, is_on_demand=True)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    words.add_argument("parts", nargs="*", type=int, default=range(10))
    rows = []
    for part in words.parse_args().parts:
        with tempfile.TemporaryDirectory() as folder, reproducible_opencv():
            gel = MountedGel(Month("development", part, PRESSES))
            bundle = Bundle.load(fit_first(gel, Path(folder)))
            for is_followed in (False, True):
                both = [judge(part, bundle, number, is_followed=is_followed) for number in GELS]
                sound, others = (sum((one[k] for one in both), Counter[str]()) for k in (0, 1))
                cells = [
                    f"{counts['pass']} of {counts.total()}, {counts['rejected']}"
                    for counts in (sound, others)
                ]
                rows.append([str(part), "yes" if is_followed else "no", *cells])
                print(*rows[-1], sep=", ", flush=True)
    print(markdown_table(["part", "followed", "sound pass, rejected", "damaged pass, rejected"], rows))


if __name__ == "__main__":
    main()
