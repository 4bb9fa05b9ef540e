"""Blender reads what is exported: blender -b --factory-startup --python blender.py -- FOLDER. Prints what it found as JSON."""

import json
import sys

import bpy
import numpy

# The importer of Debian's Blender names a type that its numpy has no more.
numpy.bool = bool

folder = sys.argv[sys.argv.index("--") + 1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=f"{folder}/result.glb")
meshes = [o for o in bpy.data.objects if o.type == "MESH"]
points = [o.matrix_world @ v.co for o in meshes for v in o.data.vertices]
found = {
    "triangles": sum(len(o.data.polygons) for o in meshes),
    "cameras": sum(o.type == "CAMERA" for o in bpy.data.objects),
    "coordinates": all(len(o.data.uv_layers) > 0 for o in meshes),
    "texture": [
        list(n.image.size)
        for n in meshes[0].data.materials[0].node_tree.nodes
        if n.type == "TEX_IMAGE" and any(l.to_socket.name == "Base Color" for l in n.outputs["Color"].links)
    ],
    "up": max(p.z for p in points),
    "lamps": [
        {"place": list(o.matrix_world.translation), "color": list(o.data.color), "watts": o.data.energy}
        for o in bpy.data.objects
        if o.type == "LIGHT" and o.data.type == "POINT"
    ],
    "light": list(bpy.data.images.load(f"{folder}/light.exr").size),
}
print("found " + json.dumps(found))
