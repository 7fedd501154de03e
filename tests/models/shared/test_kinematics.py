import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from firmware_py.link.marker_layout import square_corners_m
from models.shared.kinematics import base_corners_m, base_rotation, pointing_angles_rad, rigid_tip_m


@given(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), st.floats(0.1, 2))
def test_joint_1_turns_about_y_and_carries_joint_2_about_minus_x(angle, length_m):
    rotation = base_rotation(np.array([angle]))[0]
    intrinsic = Rotation.from_euler("YX", [angle[0], -angle[1]]).as_matrix()
    assert rotation == pytest.approx(intrinsic, abs=1e-15)
    tip = rigid_tip_m(np.array([angle]), 0.06, length_m)
    assert pointing_angles_rad(tip)[0] == pytest.approx(angle, abs=1e-12)


def test_signs_of_the_contract():
    tip = rigid_tip_m(np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]]), 0.06, 0.95)
    assert tip[0] == pytest.approx([0, 0, 1.01])
    assert tip[1] == pytest.approx([1.01 * np.sin(0.2), 0, 1.01 * np.cos(0.2)])
    assert tip[2] == pytest.approx([0, 1.01 * np.sin(0.2), 1.01 * np.cos(0.2)])
    one = np.linspace(-1, 1, 5)[:, None]
    two = np.column_stack([one, np.zeros(5)])
    assert np.array_equal(base_rotation(one), base_rotation(two))


def test_corners_stand_in_the_order_of_a_marker_row_and_turn_with_the_joint():
    upright, turned = base_corners_m(np.array([[0.0], [np.pi / 2]]), 0.06, square_corners_m(0.15))
    assert np.sign(upright[:, :2]).tolist() == [[1, 1], [-1, 1], [1, -1], [-1, -1]]
    assert np.abs(upright[:, :2]) == pytest.approx(0.075)
    assert upright[:, 2] == pytest.approx(0.06)
    assert turned[:, 0] == pytest.approx(0.06)  # the plate's axis now points along +x
    assert np.sign(turned[:, 2]).tolist() == [-1, 1, -1, 1]  # its +x edge points down
