"""The report in a real browser: plots to zoom into, the picture at the cursor, phones and wide screens, print."""

from __future__ import annotations

import re
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

from fusion.report import write_report
from fusion.report.explore import explore_data
from tests.fusion.fused import Fused, make_flight

BROWSER = next(
    (found for name in ("chromium", "google-chrome", "chromium-browser") if (found := shutil.which(name))),
    None,
)
PROBE = """<script>
addEventListener("load", () => {
  const slider = document.getElementById("explore-time");
  slider.value = 2.1;
  slider.dispatchEvent(new Event("input"));
  const told = document.body.dataset;
  told.said = document.getElementById("explore-said").textContent;
  told.across = document.documentElement.scrollWidth;
  told.legend = document.querySelector(".u-legend").textContent;
});
</script></body>"""


@pytest.fixture(scope="module")
def fused(tmp_path_factory: pytest.TempPathFactory) -> Fused:
    return make_flight(tmp_path_factory.mktemp("flight"), duration_s=4.0)


@pytest.fixture(scope="module")
def report(fused: Fused, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(*fused, path)
    return path


def browse(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    if BROWSER is None:
        pytest.skip("no browser")
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000", *options]
    return subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("scheme", [0, 1], ids=["dark", "light"])
@pytest.mark.parametrize(
    "across_px", [500, 1280]
)  # headless Chromium lays out no narrower page for --dump-dom
def test_the_slider_moves_cursor_and_picture(
    report: Path, tmp_path: Path, across_px: int, scheme: int
) -> None:
    page = tmp_path / "page.html"
    page.write_text(report.read_text(encoding="utf-8").replace("</body>", PROBE), encoding="utf-8")
    scheme_option = f"--blink-settings=preferredColorScheme={scheme}"
    dom = browse(page, "--dump-dom", f"--window-size={across_px},1200", scheme_option).stdout
    assert re.search(r'<section id="explore"(?![^>]*hidden)', dom)
    assert dom.count("<canvas") == 2
    told = dict(re.findall(r'data-(\w+)="([^"]*)"', re.findall(r"<body[^>]*>", dom)[0]))
    assert told["said"].startswith("Frame at 2.10 s")
    assert re.match(r"time, s\W*2\.1", told["legend"])
    assert int(told["across"]) <= across_px


def test_without_scripts_and_in_print_the_section_stays_away(report: Path, tmp_path: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert re.search(r'<section id="explore"[^>]* hidden>', text)
    assert re.search(r"@media print \{\s*#explore \{ display: none; \}", text)
    pdf = tmp_path / "report.pdf"
    browse(report, f"--print-to-pdf={pdf}")
    assert pdf.read_bytes().startswith(b"%PDF")


def test_series_are_those_of_the_tables(fused: Fused) -> None:
    result, flight = fused
    data = explore_data(result, flight)
    assert data is not None
    heading, offset = data["plots"]
    assert (heading["unit"], offset["unit"]) == ("degrees right", "m right")
    found = {one["name"]: one["values"] for one in heading["series"]}
    assert set(found) == {"low", "high", "frames", "filter", "smoother", "truth"}
    assert all(len(values) == len(data["t_s"]) for values in found.values())
    k = len(data["t_s"]) // 2
    row = int(abs((result.estimates["timestamp_ns"] - result.origin_ns) / 1e9 - data["t_s"][k]).argmin())
    degrees = 57.29577951308232
    assert found["filter"][k] == pytest.approx(result.estimates["heading_rad"][row] * degrees, abs=1e-3)
    sigma = result.estimates["heading_std_rad"][row] * degrees
    assert found["high"][k] - found["low"][k] == pytest.approx(4 * sigma, abs=1e-3)
    assert sum(v is not None for v in found["frames"]) == len(result.frames)
    times = [shown["t_s"] for shown in data["pictures"]]
    assert times == sorted(times)
    assert min(b - a for a, b in pairwise(times)) >= 0.25
