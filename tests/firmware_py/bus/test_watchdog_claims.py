"""Help of `run` about what keeps the torque on when the program is gone."""

from firmware_py.__main__ import main


def test_the_help_of_run_says_what_sigkill_leaves_behind(capsys):
    assert main(["run", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert all(word in text for word in ("SIGKILL", "power loss", "(-R)", "dropstitch release"))
