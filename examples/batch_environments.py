"""One scene in eight environments, each a little later and with its own place: one simulation, one stream."""

import evis
from evis.motion import Placement, Spin

builder = evis.SceneBuilder("batch", duration=2.0, ambient=(1.0, 1.0, 1.0))
builder.texture("checker", pattern="checker")
builder.material("painted", texture="checker")
spin = Placement(motion=Spin(degrees_per_s=180.0, axis=(0, 1, 0)))
builder.box("cube", size=(1, 1, 1), material="painted", pose=spin)
eye = Placement(position=(0, 0.5, 2.5), look_at=(0, 0, 0))
builder.camera(evis.EventCamera(name="eye", width=64, height=48, pose=eye))
for index in range(8):
    nudge = Placement(position=(0.05 * index, 0, 0))
    builder.environments(1, time_offset_s=0.1 * index, offsets={"cube": nudge})

sim = evis.Simulator(builder.build(), rate_hz=250.0, samples=1)
counts = [0] * sim.environments
for packet in sim.stream(duration=0.1):
    for environment in packet:
        counts[environment.index] += len(environment.events)
    third = packet[3].events
    print(
        f"{packet.start_us:6d} us: environment 3 has {len(third)} events, {int(third['p'].sum())} of them ON"
    )
print("events by environment:", counts)
