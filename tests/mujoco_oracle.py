"""MuJoCo's own pictures by its software OpenGL, as a program: ``model.mjb camera width height out.npz``."""

import os
import sys

os.environ["MUJOCO_GL"] = "osmesa"

import mujoco
import numpy as np

path, camera, width, height, out = sys.argv[1:]
model = mujoco.MjModel.from_binary_path(path)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, int(height), int(width))
renderer.update_scene(data, int(camera))
renderer.enable_depth_rendering()
depth = renderer.render().copy()
renderer.disable_depth_rendering()
renderer.enable_segmentation_rendering()
np.savez(out, depth=depth, segmentation=renderer.render().copy())
renderer.close()
