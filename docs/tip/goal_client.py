"""Example of a program that sends goals: the tip on a circle of 0.1 m, once in eight seconds.

python docs/tip/goal_client.py /tmp/goals
"""

import json
import math
import socket
import sys
import time

robot = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
for _ in range(600):
    try:
        robot.connect(sys.argv[1])
        break
    except OSError:  # the robot does not listen yet
        time.sleep(0.1)
start = None
while data := robot.recv(4096):
    status = json.loads(data)
    if start is None:
        start = status["time_s"], status["tip_m"][: len(status["goal_rad"])]
    seconds = status["time_s"] - start[0]
    turn = 2 * math.pi * seconds / 8
    way = [0.1 * math.sin(turn), 0.1 - 0.1 * math.cos(turn)]
    tip = [at + by for at, by in zip(start[1], way, strict=False)]
    goal = {"end": True} if seconds > 8 else {"tip_m": tip}
    robot.send(json.dumps({"tick": status["tick"], **goal}).encode())
    if seconds > 8 or status["reason"]:
        break
