"""A closed loop at 100 Hz: an agent sees events, and turns its camera after a ball it does not know about."""

import numpy as np

import evis
from evis.motion import Placement

builder = evis.SceneBuilder("chase", duration=2.0, ambient=(1.0, 1.0, 1.0))
builder.texture("checker", pattern="checker")
builder.material("painted", texture="checker")
builder.sphere("ball", radius=0.3, material="painted", pose=Placement(position=(-0.4, 0, 0)))
eye = Placement(position=(0, 0, 3))
builder.camera(evis.EventCamera(name="eye", width=64, height=48, pose=eye))

# The ball is moved by a physics engine, the camera by the agent: both come from outside.
sim = evis.Simulator(builder.build(), quality="standard", poses=["ball", "eye"], pose_step_us=10_000)

yaw = 0.0
for step in range(1, 21):
    t_s = 0.01 * step
    ball = [-0.4 + 2.0 * t_s, 0, 0, 0, 0, 0, 1]
    camera = [0, 0, 3, 0, np.sin(yaw / 2), 0, np.cos(yaw / 2)]
    packet = sim.step(10_000 * step, poses={"ball": ball, "eye": camera})
    if len(packet.events):
        # Where the events lie from the middle of the picture, as a part of its width, steers.
        off = packet.x.mean() / 64 - 0.5
        yaw -= 0.3 * off
    if step % 5 == 0:
        print(f"{packet.end_us:6d} us: {len(packet.events)} events, yaw {np.degrees(yaw):+.2f} degrees")
