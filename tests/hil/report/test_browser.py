"""The pages in a real browser, as wide as a desk's screen and as a phone's."""

import html
import json
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
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium"),
]


@pytest.fixture(scope="module", params=["page", "gap_page"])
def shown(request):
    """Path of a page."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module", params=[(1280, 900), (390, 844)], ids=["desktop", "phone"])
def seen(request, shown, tmp_path_factory):
    """What the browser measured and what it complained of."""
    directory = tmp_path_factory.mktemp("browser")
    copy = directory / "report.html"
    copy.write_text(shown.read_text(encoding="utf-8").replace("</body>", MEASURE), encoding="utf-8")
    width, height = request.param
    frame = directory / "frame.html"
    frame.write_text(FRAME % (width, height), encoding="utf-8")
    done = subprocess.run(
        [CHROMIUM, *FLAGS, "--virtual-time-budget=10000",
         f"--user-data-dir={directory / 'profile'}", "--dump-dom", frame.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    found = re.search(r'data-measured="([^"]*)"', done.stdout)
    assert found, done.stderr[-2000:]
    return width, json.loads(html.unescape(found[1])), done.stderr


def test_nothing_is_wider_than_the_screen(seen):
    width, measured, _ = seen
    assert measured["width"] == width
    assert measured["wide"] == []
    assert measured["content"] <= width


def test_the_browser_has_nothing_to_complain_of(seen):
    _, _, complaints = seen
    assert "CONSOLE" not in complaints


def test_panels_stand_side_by_side_only_where_there_is_room(seen):
    width, measured, _ = seen
    assert measured["columns"] == (2 if width > 1000 else 1)


def test_text_in_drawings_is_legible_and_inside(seen):
    _, measured, _ = seen
    assert measured["smallest"] >= 9
    assert measured["outside"] == []


def test_every_link_leads_somewhere(seen):
    _, measured, _ = seen
    assert measured["links"] == 0
