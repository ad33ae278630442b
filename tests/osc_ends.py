"""For tests of OSC: a known pose, and a receiver of everything."""

import threading
import time
from contextlib import contextmanager

import numpy as np
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer

from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.motion.kinematics import clip_from_qpos, standing_clip
from questsim.skeleton import DOFS


def pose_of(turn_deg: float = 0.0, x: float = 0.0, **angles: float) -> AvatarPose:
    """Standing, arms hanging, but for some joint angles in degrees; turned to the left."""
    qpos = standing_clip(1.75).qpos[0].copy()
    qpos[0] = x
    qpos[3:7] = rot.yaw_quat(np.array(np.radians(turn_deg)))
    for name, angle in angles.items():
        qpos[7 + DOFS.index(name)] = np.radians(angle)
    clip = clip_from_qpos("pose", qpos[None], 1.75)
    return AvatarPose(
        1.5, 1.75, qpos[:3], qpos[3:7], qpos[7:], clip.link_position[0], clip.link_quat[0],
        np.zeros((2, 3)), np.zeros(3), np.zeros(3),
    )  # fmt: skip


@contextmanager
def listening():
    """A receiver of everything; gives its port and the messages that have come."""
    got: list[tuple] = []
    dispatcher = Dispatcher()
    dispatcher.set_default_handler(lambda address, *values: got.append((address, *values)))
    server = BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_address[1], got
    finally:
        server.shutdown()
        server.server_close()


def wait_for(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing came"
        time.sleep(0.01)
