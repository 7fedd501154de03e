"""`new` at a terminal: it asks, tells a wrong answer at once, and leaves no half a file."""

import os
import pty
import select
import signal
import sys
import time

import pytest

from firmware_py.link.link_description import read_link

WAIT_S = 60.0
PATIENCE_S = 5.0
CTRL_C, CTRL_D = b"\x03", b"\x04"


class Terminal:
    """`dropstitch new` on a pseudo-terminal of its own."""

    def __init__(self, *arguments):
        self.process, self.file = pty.fork()
        if not self.process:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # a job in the background ignores it
            os.execv(
                sys.executable, [sys.executable, "-m", "dropstitch", "new", *map(str, arguments)]
            )
        self.shown, self.end_s = "", time.monotonic() + WAIT_S

    def read(self):
        """Return what is shown next, nothing after the end."""
        assert select.select([self.file], [], [], self.end_s - time.monotonic())[0], self.shown
        try:
            return os.read(self.file, 4096).decode()
        except OSError:  # EIO: the other side is closed
            return ""

    def until(self, text):
        """Read until a text is shown; return what was shown before it."""
        while text not in self.shown:
            more = self.read()
            assert more, self.shown
            self.shown += more
        before, _, self.shown = self.shown.partition(text)
        return before

    def answer(self, question, text):
        """Wait for a question and answer it; return what was said before it."""
        said = self.until(question) + self.until("]: ")
        os.write(self.file, text if isinstance(text, bytes) else text.encode() + b"\n")
        return said

    def end(self, key=b""):
        """Return exit code and the rest of what was shown; press a key until the program ends.

        Python can miss a signal that comes just before it reads.
        """
        pressed_s = 0.0
        while True:
            if key and time.monotonic() - pressed_s > PATIENCE_S:
                os.write(self.file, key)
                pressed_s = time.monotonic()
            if select.select([self.file], [], [], 0.1)[0] or not key:
                if not (more := self.read()):
                    break
                self.shown += more
        code = os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])
        self.process = 0
        return code, self.shown

    def close(self):
        if self.process:
            os.kill(self.process, signal.SIGKILL)
            os.waitpid(self.process, 0)
        os.close(self.file)


@pytest.fixture
def terminal():
    opened = []

    def start(*arguments):
        opened.append(Terminal(*arguments))
        return opened[-1]

    yield start
    for each in opened:
        each.close()


def test_wrong_answers_are_told_and_empty_ones_take_the_value_in_brackets(terminal, tmp_path):
    at = terminal(tmp_path / "link.toml")
    at.answer("length from", "0,6")
    assert "'0,6' is no number" in at.answer("length from", "60")
    assert "length_m is 60, outside 0.05 to 10" in at.answer("length from", "nan")
    assert "length_m is nan" in at.answer("length from", "0.6")
    at.answer("section, one of square, round [square", "")
    at.answer("side or", "-0.1")
    assert "width_m is -0.1" in at.answer("side or", "0.1")
    at.answer("base plate above", "")
    at.answer("inflation", "20700")
    at.answer("driven joints, one of 1, 2", "1.5")
    assert "'1.5' is no whole number" in at.answer("driven joints", "3")
    assert "'3' is not one of 1, 2" in at.answer("driven joints", "1")
    at.answer("rows of markers", "0")
    assert "give 1 to 99" in at.answer("rows of markers", "3")
    at.answer("markers in a row", "")
    at.answer("mounting, one", "upside down")
    assert "is not one of upright" in at.answer("mounting, one", "balloon")
    at.answer("part of the weight", "40")
    assert "effective_weight is 40" in at.answer("part of the weight", "0.4")
    at.answer("servo, one", "XM430-W350")
    at.answer("largest payload", "")
    code, said = at.end()
    assert code == 0 and "12 markers, balloon, XM430-W350" in said and "Traceback" not in said
    link = read_link(tmp_path / "link.toml")
    assert (link.length_m, link.width_m, link.section) == (0.6, 0.1, "square")
    assert (link.base_offset_m, link.pressure_pa, link.joints) == (0.06, 20700.0, 1)
    assert (link.layout.rows, link.layout.corners) == (3, 4)
    assert link.gravity.effective_weight == 0.4 and link.payload_kg > 0


@pytest.mark.parametrize(
    ("key", "code", "sentence"),
    [
        (CTRL_C, 130, "dropstitch: interrupted"),
        (CTRL_D, 2, "is not written, the answers end before the last question"),
    ],
)
def test_leaving_writes_nothing_and_says_one_sentence(terminal, tmp_path, key, code, sentence):
    at = terminal(tmp_path / "link.toml")
    at.answer("length from", "0.6")
    at.until("section, one of")
    at.until("]: ")
    left, said = at.end(key)
    lines = [line for line in said.splitlines() if line.strip("^CD\b ")]
    assert left == code and len(lines) == 1 and sentence in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_with_options_nothing_is_asked(terminal, tmp_path):
    code, said = terminal(tmp_path / "link.toml", "--length", "0.6").end()
    assert code == 0 and "]:" not in said
    assert read_link(tmp_path / "link.toml").width_m == 0.15
