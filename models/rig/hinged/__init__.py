"""Rig on MuJoCo: a link of hinge and shear pairs, and its bending law."""
