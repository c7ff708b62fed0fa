"""Two cameras on one rig, with depth and flow: streamed into a file and read back."""

import tempfile
from pathlib import Path

import evis
from evis.motion import FigureEight, Placement

builder = evis.SceneBuilder("stereo", duration=4.0, ambient=(1.0, 1.0, 1.0))
builder.texture("bricks", pattern="bricks")
builder.material("wall", texture="bricks")
builder.card("wall", size=(8, 4), material="wall", uv_repeat=(4, 2), pose=Placement(position=(0, 0, -3)))
builder.box("box", size=(0.5, 0.5, 0.5), material="wall", pose=Placement(position=(0, 0, -1)))
builder.node("rig", pose=Placement(motion=FigureEight(size=(0.3, 0.1), period_s=4.0)))
for name, x in (("left", -0.06), ("right", 0.06)):
    pose = Placement(parent="rig", position=(x, 0, 0))
    builder.camera(evis.EventCamera(name=name, width=160, height=120, pose=pose))

sim = evis.Simulator(builder.build(), rate_hz=500.0, samples=1, labels=["depth", "flow"], label_rate_hz=100.0)
path = Path(tempfile.mkdtemp()) / "stereo.h5"
evis.save(path, sim.stream(duration=0.05))

recording = evis.load(path)
for name, view in recording.items():
    depth = view.labels["depth"].data
    flow = view.labels["flow_forward"]
    print(
        f"{name}: {len(view)} events, depth {depth.shape} from {depth.min():.2f} m, {len(flow)} flow fields"
    )
    first = view.slice_time(0, 10_000)
    print(f"  {len(first)} events in the first 10 ms; the camera starts at {view.poses.position[0].round(3)}")
