"""What the page costs: the time until it is painted, and its share of one core while a station inspects.

Budgets: painted in 300 ms, 2 % of a core. The share is that of the process of the gateway, with the page open in a
browser and without the page, in turn; the share of the browser is next to it.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from chromium import BROWSER_MS, wait_until
from page_pictures import SCENES, served
from ports import free_port
from station import JSONL, Motion, press_recording, small_bundle, station_config

pytestmark = pytest.mark.bench

GELGATE = Path(sys.executable).parent / "gelgate"
FPS, EVERY_S = 25.0, 3.0
WARM_UP_S, MEASURED_S, ROUNDS = 15.0, 45.0, 3
OPENINGS = 21

# When the verdict is on the screen: two frames after its text has come.
NOTE_VERDICT = """
new MutationObserver((changes, observer) => {
  if (document.querySelector("#verdict.fail")) {
    observer.disconnect();
    requestAnimationFrame(() => requestAnimationFrame(() => { window.verdictMs = performance.now(); }));
  }
}).observe(document, { subtree: true, childList: true, attributes: true });
"""
PAINTED = "performance.getEntriesByName('first-contentful-paint')[0]"


def test_time_until_it_is_painted(browser: Any) -> None:
    """In a new window each time, so nothing is in a cache; the page has presses, a picture and an alarm."""
    painted, seen, loaded = [], [], []
    with served(SCENES["page"]) as port:
        for _ in range(OPENINGS):
            context = browser.new_context(viewport={"width": 1280, "height": 900})
            tab = context.new_page()
            tab.set_default_timeout(BROWSER_MS)
            tab.add_init_script(NOTE_VERDICT)
            tab.goto(f"http://127.0.0.1:{port}/")
            wait_until(tab, f"window.verdictMs && {PAINTED}?.startTime")
            painted.append(tab.evaluate(f"{PAINTED}.startTime"))
            seen.append(tab.evaluate("window.verdictMs"))
            sizes = "performance.getEntries().reduce((sum, one) => sum + (one.decodedBodySize || 0), 0)"
            loaded.append(tab.evaluate(sizes))
            context.close()

    print(
        f"\n{OPENINGS} openings, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, median (least, most):"
    )
    print(f"painted after {spread(painted)} ms (budget 300), the verdict after {spread(seen)} ms")
    print(f"{median(loaded) / 1e3:.0f} kB with the picture of the press")


def spread(values: list[float]) -> str:
    return f"{median(values):.0f} ({min(values):.0f}, {max(values):.0f})"


def station(folder: Path, bundle: Path, port: int | None) -> Path:
    """25 frames and a third of a press a second."""
    frames = round(FPS * EVERY_S)
    motion = Motion(free=frames, idle=frames - 14, hold=12)
    recording = press_recording(folder / "presses", 4, dented=[1], motion=motion, fps=FPS)
    sinks = JSONL % (folder / "out")
    if port is not None:
        sinks += f'[[sinks]]\nplugin = "page"\noptions = {{ port = {port} }}\n'
    return station_config(folder / "station", recording, bundle, pace=1.0, loop=True, sinks=sinks)


@contextmanager
def gateway(config: Path) -> Iterator[int]:
    with subprocess.Popen([GELGATE, "run", "-c", config], stdout=subprocess.DEVNULL) as running:
        try:
            yield running.pid
        finally:
            running.terminate()


def cpu_s(pid: int) -> float:
    """Time on a core of all its threads, in the program and in the kernel (proc(5): fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def browser_s() -> float:
    """The same of Chromium's processes that this one has started."""
    children = [pid for pid in map(int, filter(str.isdigit, os.listdir("/proc"))) if is_ours(pid)]
    return sum(cpu_s(pid) for pid in children)


def is_ours(pid: int) -> bool:
    """Whether it is a browser, and this process is among those that it comes from."""
    try:
        if "chrom" not in Path(f"/proc/{pid}/comm").read_text():
            return False
        while pid not in (0, 1, os.getpid()):
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return False
    return pid == os.getpid()


def test_share_of_a_core(tmp_path: Path, browser: Any) -> None:
    """With the page open and without the page, in turn."""
    bundle = small_bundle(tmp_path / "bundle", press_recording(tmp_path / "nominal", 12, seed=1))
    shares: dict[bool, list[float]] = {False: [], True: []}
    browsers = []
    for number in range(2 * ROUNDS):
        has_page, folder, port = number % 2 == 1, tmp_path / str(number), free_port()
        config = station(folder, bundle, port if has_page else None)
        with ExitStack() as opened:
            pid = opened.enter_context(gateway(config))
            while not (folder / "out" / "messages.jsonl").exists():
                time.sleep(0.5)
            time.sleep(WARM_UP_S)
            tab = None
            if has_page:
                tab = browser.new_page(viewport={"width": 1280, "height": 900})
                tab.set_default_timeout(BROWSER_MS)
                tab.goto(f"http://127.0.0.1:{port}/")
                tab.wait_for_selector("#verdict.pass, #verdict.fail")
                time.sleep(2 * EVERY_S)
            gateway_before_s, browser_before_s, start = cpu_s(pid), browser_s(), time.perf_counter()
            time.sleep(MEASURED_S)
            elapsed_s = time.perf_counter() - start
            shares[has_page].append((cpu_s(pid) - gateway_before_s) / elapsed_s)
            if tab is not None:
                browsers.append((browser_s() - browser_before_s) / elapsed_s)
                tab.close()

    without, with_page = median(shares[False]), median(shares[True])
    print(f"\n{FPS:g} frames a second, a press every {EVERY_S:g} s, {ROUNDS} times {MEASURED_S:g} s each:")
    print(f"gateway without the page {without:.1%} of a core, with it open {with_page:.1%}")
    print(
        f"the page costs {with_page - without:+.1%} of a core (budget 2 %); Chromium itself {median(browsers):.1%}"
    )
