"""Goals of all servos, sent by one sync write, which no servo answers."""

from __future__ import annotations

from typing import Final

from dynamixel_sdk.robotis_def import BROADCAST_ID, COMM_SUCCESS, INST_SYNC_WRITE
from numpy import float64
from numpy.typing import NDArray

from firmware_py.bus.port import DeadlinePort, PacketHandler
from firmware_py.bus.registers import Register
from firmware_py.bus.servo_bus import BusStatus
from firmware_py.bus.servo_models import Model

_FIRST: Final = 12
"""Offset of the first servo's bytes, behind header, id, length, instruction, address and size."""
_CRC: Final = 2


class GoalWriter:
    """Writer of goals to servos of one control table.

    Parameters
    ----------
    port : DeadlinePort
        Port to the servos.
    packets : PacketHandler
        The SDK's Protocol 2.0.
    models : dict of int to Model
        Servos by id, in joint order.
    """

    def __init__(
        self, port: DeadlinePort, packets: PacketHandler, models: dict[int, Model]
    ) -> None:
        self._port, self._packets = port, packets
        self._models = list(models.values())
        self._cell = self._models[0].table[Register.GOAL_POSITION]
        address, size = self._cell[:2]
        length = _FIRST - 7 + len(models) * (1 + size) + _CRC
        # Only the goals change; the packet handler fills in header and CRC.
        self._instruction = [
            *(0, 0, 0, 0), BROADCAST_ID, length & 0xFF, length >> 8, INST_SYNC_WRITE,
            address & 0xFF, address >> 8, size & 0xFF, size >> 8,
        ]  # fmt: skip
        self._goals: list[slice] = []
        for servo_id in models:
            start = len(self._instruction) + 1
            self._goals.append(slice(start, start + size))
            self._instruction += (servo_id, *bytes(size))
        self._instruction += bytes(_CRC)

    def put(self, goal_rad: NDArray[float64]) -> BusStatus:
        """Send the goals.

        Parameters
        ----------
        goal_rad : ndarray, shape (dof,)
            Goal angles.

        Raises
        ------
        ValueError
            If a goal is not finite or does not fit the register.
        OSError
            If the port is gone.
        """
        encode, instruction = self._cell.encode, self._instruction
        for model, place, angle_rad in zip(
            self._models, self._goals, goal_rad.tolist(), strict=True
        ):
            instruction[place] = encode(model.position_raw(angle_rad))
        result = self._packets.tell(self._port, instruction)
        return BusStatus.OK if result == COMM_SUCCESS else BusStatus.TIMEOUT
