"""`new` at a terminal: it asks, reports a wrong answer at once, and writes no partial file."""

import signal
import sys

import pexpect
import pytest

from firmware_py.link.link_description import read_link


@pytest.fixture
def start(tmp_path):
    """Start the command on a pseudo-terminal."""
    children = []

    def spawn(*options):
        command = ["-m", "dropstitch", "new", str(tmp_path / "link.toml"), *options]
        children.append(pexpect.spawn(
            sys.executable, command, timeout=60, encoding="utf-8",
            # A job in the background ignores it.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ))  # fmt: skip
        return children[-1]

    yield spawn
    for child in children:
        child.close(force=True)


def answer(child, question, text):
    """Wait for a question and answer it; return what was shown before it."""
    child.expect_exact(question)
    before = child.before
    child.expect_exact("]: ")
    child.sendline(text)
    return before


def end(child):
    """Exit code and the rest of what was shown."""
    child.expect(pexpect.EOF)
    child.close()
    return child.exitstatus, child.before


def test_wrong_answers_are_reported_and_empty_ones_take_the_value_in_brackets(start, tmp_path):
    child = start()
    answer(child, "length from", "0,6")
    for question, refusal, text in (
        ("length from", "'0,6' is no number", "60"),
        ("length from", "length_m is 60", "0.6"),
        ("section, one of square, round [square", "", ""),
        ("side or", "", "-0.1"),
        ("side or", "width_m is -0.1", "0.1"),
        ("base plate above", "", ""),
        ("inflation", "", "20700"),
        ("driven joints, one of 1, 2", "", "1.5"),
        ("driven joints", "'1.5'", "3"),
        ("driven joints", "'3' is not one of 1, 2", "1"),
        ("rows of markers", "", "0"),
        ("rows of markers", "give 1 to 99", "3"),
        ("markers in a row", "", ""),
        ("mounting, one", "", "upside down"),
        ("mounting, one", "is not one of upright", "balloon"),
        ("part of the weight", "", "40"),
        ("part of the weight", "effective_weight is 40", "0.4"),
        ("servo, one", "", "XM430-W350"),
        ("largest payload", "", ""),
    ):
        assert refusal in answer(child, question, text)
    code, shown = end(child)
    assert code == 0 and "12 markers, balloon, XM430-W350" in shown and "Traceback" not in shown
    link = read_link(tmp_path / "link.toml")
    assert (link.length_m, link.width_m, link.section) == (0.6, 0.1, "square")
    assert (link.base_offset_m, link.pressure_pa, link.joints) == (0.06, 20700.0, 1)
    assert (link.layout.rows, link.layout.corners) == (3, 4)
    assert link.gravity.effective_weight == 0.4 and link.payload_kg > 0


@pytest.mark.parametrize(
    ("key", "code", "sentence"),
    [
        ("\x03", 130, "dropstitch: interrupted"),  # Ctrl-C
        ("\x04", 2, "is not written, the answers end before the last question"),  # Ctrl-D
    ],
)
def test_an_interrupt_writes_nothing_and_gives_one_sentence(start, tmp_path, key, code, sentence):
    child = start()
    answer(child, "length from", "0.6")
    child.expect_exact("section, one of")
    child.expect_exact("]: ")
    # Python can miss a signal that comes just before it reads: press the key until it ends.
    ended = False
    while not ended:
        child.send(key)
        ended = child.expect([pexpect.EOF, pexpect.TIMEOUT], timeout=5) == 0
    child.close()
    lines = [line for line in child.before.splitlines() if line.strip("^CD\b ")]
    assert child.exitstatus == code and len(lines) == 1 and sentence in lines[0]
    assert list(tmp_path.iterdir()) == []
