"""Render a Blender scene as EVIS reads it: multi-layer EXR with Combined, Depth and Vector, a file per frame.

Outside of Blender it makes a small scene of known motion: a checkered card, 4 m away, that moves by 0.2 m to
the right and 0.1 m up from frame to frame, before a wall, 6 m away.

    blender --background scene.blend --python examples/blender/render.py -- out/
    python examples/blender/render.py out/      # with the package bpy; the small scene
"""

import sys
from pathlib import Path

import bpy

FRAMES = 4


def passes(scene: "bpy.types.Scene", folder: Path) -> None:
    """Ask for what EVIS needs; everything else of the scene stays as it is."""
    scene.render.engine = "CYCLES"
    scene.render.use_motion_blur = False  # with it there is no vector pass
    for layer in scene.view_layers:
        layer.use_pass_z = True
        layer.use_pass_vector = True
    image = scene.render.image_settings
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "32"
    image.exr_codec = "ZIP"
    scene.render.filepath = f"{folder}/frame_####.exr"


def checkered(name: str, low: float, high: float, scale: float) -> "bpy.types.Material":
    """Return a material that shines by itself, so that light is what the pattern says."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    pattern = nodes.new("ShaderNodeTexChecker")
    pattern.inputs["Color1"].default_value = (low, low, low, 1)
    pattern.inputs["Color2"].default_value = (high, high, high, 1)
    pattern.inputs["Scale"].default_value = scale
    place = nodes.new("ShaderNodeTexCoord")
    shine = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(place.outputs["UV"], pattern.inputs["Vector"])
    links.new(pattern.outputs["Color"], shine.inputs["Color"])
    links.new(shine.outputs["Emission"], output.inputs["Surface"])
    return material


def small_scene() -> "bpy.types.Scene":
    """Make the scene of known motion; the camera looks along -Z from z = 6, f = 64 * 50 / 36 pixels."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=8, location=(0, 0, 0))
    bpy.context.object.data.materials.append(checkered("wall", 0.1, 0.3, 6))
    bpy.ops.mesh.primitive_plane_add(size=1.6, location=(0, 0, 2))
    card = bpy.context.object
    card.data.materials.append(checkered("card", 0.4, 0.9, 4))
    for frame in range(-1, FRAMES + 3):
        card.location = (-0.4 + 0.2 * frame, -0.3 + 0.1 * frame, 2)
        card.keyframe_insert("location", frame=frame)
    for curve in card.animation_data.action.fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    bpy.ops.object.camera_add(location=(0, 0, 6))
    scene.camera = bpy.context.object
    scene.camera.data.lens, scene.camera.data.sensor_width = 50, 36
    scene.cycles.samples = 32
    scene.cycles.use_denoising = False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 48, 100
    scene.frame_start, scene.frame_end = 0, FRAMES - 1
    return scene


if __name__ == "__main__":
    inside = "--" in sys.argv
    arguments = sys.argv[sys.argv.index("--") + 1 :] if inside else sys.argv[1:]
    target = Path(arguments[0]).absolute()
    rendered = bpy.context.scene if inside else small_scene()
    passes(rendered, target)
    bpy.ops.render.render(animation=True)
