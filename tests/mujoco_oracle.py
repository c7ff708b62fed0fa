"""MuJoCo's own pictures by its software OpenGL, as a program: ``model.mjb camera width height out.npz``."""

import inspect
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
orthographic = getattr(renderer.scene.camera[0], "orthographic", False)
if orthographic and "orthographic" not in inspect.getsource(renderer.render):
    # This release takes what it reads for perspective depth, whose inverse is linear in it; depth itself is.
    near, far = (plane * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar))
    depth = near + (1 / depth.astype(np.float64) - 1 / near) / (1 / far - 1 / near) * (far - near)
renderer.disable_depth_rendering()
renderer.enable_segmentation_rendering()
np.savez(out, depth=depth, segmentation=renderer.render().copy())
renderer.close()
