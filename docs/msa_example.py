"""Prints the worked example of msa.md: AIAG's published study as rows of a database, reported by the program.

The measurements are those of AIAG, Measurement Systems Analysis, 4th edition, chapter III, figure III-B 15: ten parts,
three appraisers, three trials. They stand for scores here, with a threshold of 1: a larger one fails.
"""

from datetime import UTC
from pathlib import Path
from typing import Final

from calibration.gauge_study.plan import Piece, StudyPlan, make_plan, material
from calibration.gauge_study.report import markdown, report
from edge.store.study_presses import StudyPress

PAGE: Final = Path(__file__).with_name("msa.md")
BEGIN: Final = "<!-- Printed by `make docs` -->\n```markdown\n"
END: Final = "```\n<!-- end -->"

A: Final = (
    (0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36),
    (0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25),
    (0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31),
)
B: Final = (
    (0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68),
    (0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62),
    (0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50),
)
C: Final = (
    (0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49),
    (-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77),
    (-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16),
)
OPERATORS: Final = {"A": A, "B": B, "C": C}
THRESHOLD: Final = 1.0
# 2026-03-02, 06:00 UTC; a press every 20 seconds.
BEGUN_NS: Final = 1_772_431_200 * 10**9
EVERY_NS: Final = 20 * 10**9
# The two pieces that are bad by the mean of all measurements.
BAD: Final = ("P3", "P9")


def example_plan() -> StudyPlan:
    """Ten pieces, three operators, three repeats."""
    pieces = [Piece(name=f"P{n}", known="fail" if f"P{n}" in BAD else "pass") for n in range(1, 11)]
    made = make_plan(pieces, list(OPERATORS), 3, seed=1, time_ns=BEGUN_NS)
    return made.model_copy(update={"study_id": "01KJQ0D8003G0G40R40M30E209"})


def example_rows() -> list[StudyPress]:
    """In the plan's order."""
    return [
        StudyPress(
            press_id=f"{number:026d}",
            time_ns=BEGUN_NS + number * EVERY_NS,
            serial="2BNN4ZE7",
            gel_id="2BNN4ZE7-3",
            part="bolt",
            position="crest",
            bundle_id="6f1d2c0a9b8e7d55",
            step=number,
            piece=step.piece,
            operator=step.operator,
            repeat=step.repeat,
            verdict="fail"
            if (score := _score(step.operator, step.piece, step.repeat)) > THRESHOLD
            else "pass",
            score=score,
            threshold=THRESHOLD,
        )
        for number, step in enumerate(example_plan().order)
    ]


def _score(operator: str, piece: str, repeat: int) -> float:
    return OPERATORS[operator][repeat - 1][int(piece[1:]) - 1]


def example() -> str:
    """The report as `gelgate lab msa report` prints it."""
    return markdown("Measurement systems analysis", report(material(example_plan(), example_rows()), UTC))


def page() -> str:
    """msa.md with the example as the program prints it now."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{before}{BEGIN}{example()}{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print("docs/msa.md")
