"""Each control of the OpenSSF baseline, levels 1 and 2, has evidence that is there, or says why it is not met."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/osps.md"
ROWS = re.findall(r"^\| OSPS-(\S+) \| .+? \| (.+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
# docs/versions/2026-08-28-checklist.md of github.com/ossf/security-baseline: level 1, then level 2.
CONTROLS = """\
AC-01.01 AC-02.01 AC-03.01 AC-03.02 BR-01.01 BR-01.03 BR-03.01 BR-03.02 BR-07.01 DO-01.01 DO-02.01 GV-02.01 GV-03.01
LE-02.01 LE-02.02 LE-03.01 LE-03.02 QA-01.01 QA-01.02 QA-02.01 QA-04.01 QA-05.01 QA-05.02 VM-02.01

AC-04.01 BR-02.01 BR-04.01 BR-05.01 BR-06.01 DO-06.01 DO-07.01 GV-01.01 GV-01.02 GV-03.02 LE-01.01 QA-03.01 QA-06.01
SA-01.01 SA-02.01 SA-03.01 VM-01.01 VM-03.01 VM-04.01
"""


def test_every_control_has_its_row() -> None:
    assert [control for control, _ in ROWS] == CONTROLS.split()


@pytest.mark.parametrize(("control", "evidence"), ROWS)
def test_evidence_is_there(control: str, evidence: str) -> None:
    """Each page and file that is named exists; without one the row says why the control is not met."""
    paths = [PAGE.parent / page for page in re.findall(r"\]\(([^)#]+)", evidence)]
    paths += [ROOT / name for name in re.findall(r"`([\w./-]*[./][\w./-]+|LICENSE)`", evidence)]

    assert paths or re.match(r"not met, because \w+", evidence)
    assert [path for path in paths if not path.exists()] == []
