"""An event camera on a MuJoCo pendulum, used as MuJoCo's own renderer is."""

import sys

try:
    import mujoco
except ImportError:
    print("this example needs MuJoCo, pip install 'evis[mujoco]': no events")
    sys.exit()

import evis.mujoco

model = mujoco.MjModel.from_xml_string("""
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <asset>
    <texture name="grid" type="2d" builtin="checker" rgb1="0.8 0.8 0.8" rgb2="0.3 0.3 0.3" width="64"
      height="64"/>
    <material name="wall" texture="grid" texrepeat="8 8"/>
  </asset>
  <worldbody>
    <light pos="0 -2 3" dir="0 0.5 -1" directional="true"/>
    <camera name="eye" pos="0 -2 0.6" xyaxes="1 0 0 0 0 1"/>
    <geom type="plane" size="2 2 0.1" pos="0 0.5 0.6" euler="90 0 0" material="wall"/>
    <body pos="0 0 1">
      <joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" rgba="0.9 0.5 0.1 1"/>
      <geom type="sphere" pos="0 0 -0.5" size="0.08" rgba="0.1 0.3 0.9 1"/>
    </body>
  </worldbody>
</mujoco>
""")
data = mujoco.MjData(model)
data.qpos[0], data.qvel[0] = 0.5, -3.0

with evis.mujoco.EventRenderer(model, height=48, width=64, camera="eye", sensor="davis346") as renderer:
    renderer.update_scene(data, "eye")
    for step in range(1, 26):
        mujoco.mj_step(model, data)
        # Each step is taken in, and rendered when somebody asks.
        renderer.observe(data)
        if step % 5 == 0:
            events = renderer.render()
            print(f"{1000 * data.time:.0f} ms: {len(events)} events")
