"""The pages in a real browser, as wide as a desk's screen and as a phone's."""

import html
import json
import os
import re
import shutil
import subprocess

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--hide-scrollbars", "--enable-logging=stderr",
)  # fmt: skip
MEASURE = """<script>
document.querySelectorAll('details').forEach(e => { e.open = true; });
const wide = [...document.querySelectorAll('body *')].filter(e => {
  const box = e.getBoundingClientRect();
  return box.right > innerWidth + 1 && !e.closest('.table');
});
const text = [...document.querySelectorAll('figure svg text')].map(e => {
  const box = e.getBoundingClientRect();
  const frame = e.ownerSVGElement.getBoundingClientRect();
  return {
    pixels: parseFloat(getComputedStyle(e).fontSize) * frame.width /
      e.ownerSVGElement.viewBox.baseVal.width,
    outside: Math.max(frame.left - box.left, box.right - frame.right,
                      frame.top - box.top, box.bottom - frame.bottom),
    words: e.textContent,
  };
});
const panels = document.querySelector('.panels').getBoundingClientRect();
const figure = document.querySelector('.panels figure').getBoundingClientRect();
parent.postMessage(JSON.stringify({
  width: innerWidth,
  content: document.documentElement.scrollWidth,
  scrolled: [...document.querySelectorAll('.table')].filter(
    e => e.scrollWidth > e.clientWidth + 1).map(e => e.ariaLabel),
  wide: wide.slice(0, 5).map(e => e.outerHTML.slice(0, 120)),
  smallest: Math.min(...text.map(t => t.pixels)),
  outside: text.filter(t => t.outside > 1).map(t => t.words),
  columns: Math.round(panels.width / figure.width),
  links: [...document.links].filter(a => !document.querySelector(a.hash)).length,
}), '*');
</script></body>"""
# A window has a least width, a frame has none.
FRAME = """<!doctype html><html><body>
<script>
onmessage = event => { document.documentElement.dataset.measured = event.data; };
</script>
<iframe src="report.html" style="border: 0; width: %dpx; height: %dpx"></iframe>
</body></html>"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium"),
]


@pytest.fixture(scope="module", params=["page", "gap_page", "plans_html"])
def shown(request):
    """Path of a page."""
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize(("width", "height"), [(1280, 900), (390, 844)], ids=["desktop", "phone"])
def test_a_page_fits_its_screen_and_its_drawings_are_legible(shown, width, height, tmp_path):
    page = shown.read_text(encoding="utf-8").replace("</body>", MEASURE)
    (tmp_path / "report.html").write_text(page, encoding="utf-8")
    frame = tmp_path / "frame.html"
    frame.write_text(FRAME % (width, height), encoding="utf-8")
    done = subprocess.run(
        [CHROMIUM, *FLAGS, "--virtual-time-budget=10000",
         f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", frame.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)},
    )  # fmt: skip
    output = re.search(r'data-measured="([^"]*)"', done.stdout)
    assert output, done.stderr[-2000:]
    measured = json.loads(html.unescape(output[1]))
    assert measured["width"] == width
    assert measured["wide"] == []
    assert measured["scrolled"] == []
    assert measured["content"] <= width
    assert measured["columns"] == (2 if width > 1000 else 1)
    assert measured["smallest"] >= 9, "pixels of a drawing's text"
    assert measured["outside"] == []
    assert measured["links"] == 0, "links that lead nowhere"
    assert "CONSOLE" not in done.stderr
