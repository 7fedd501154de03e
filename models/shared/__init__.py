"""Shared parts of this room: effect names, kinematics, C compiler, HTML pages and charts."""
