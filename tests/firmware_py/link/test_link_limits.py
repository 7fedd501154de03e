"""A robot's configuration that names its link: servos are compared, the tip's box follows."""

import pytest

from firmware_py.config import read_config
from firmware_py.core.errors import InputError

ROBOT = """
bundle = "b"
link = "link.toml"
[bus]
port = "p"
[[servos]]
id = 1
model = "XM430-W350"
"""
LINK = """
length_m = 2.0
width_m = 0.1
base_offset_m = 0.06
pressure_pa = 20700
payload_kg = 0.1
joints = 1
[servo]
model = "XM430-W350"
"""


def read(folder, robot=ROBOT, link=LINK):
    (folder / "link.toml").write_text(link)
    (folder / "robot.toml").write_text(robot)
    return read_config(folder / "robot.toml")


def test_the_box_of_the_tip_holds_the_whole_link(tmp_path):
    limits = read(tmp_path).limits
    assert min(limits.tip_max_m) > 2.06 and max(limits.tip_min_m) < -2.06
    assert limits.current_a <= 2.3 and limits.rate_rad_s == 2.0
    slow = read(tmp_path, link=LINK + "speed_limit_rad_s = 0.7\n").limits
    assert slow.rate_rad_s == 0.7
    own = read(tmp_path, ROBOT + "[limits]\ncurrent_a = 3.0\ntip_max_m = [1.0, 1.0, 1.0]\n").limits
    assert own.current_a == 3.0 and own.tip_max_m == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("robot", "link", "said"),
    [
        (ROBOT.replace("XM430-W350", "H54-200-S500-R"), LINK, "is not the link's XM430-W350"),
        (ROBOT + '[[servos]]\nid = 2\nmodel = "XM430-W350"\n', LINK, "the link 1 joint"),
        (ROBOT, LINK.replace("= 2.0", "= 200"), "length_m is 200"),
    ],
)
def test_another_link_is_refused(tmp_path, robot, link, said):
    with pytest.raises(InputError) as caught:
        read(tmp_path, robot, link)
    assert said in str(caught.value)
