"""Reads what is exported: python read.py trimesh|open3d|pycolmap FOLDER. Prints what it found as JSON."""

import json
import sys

reader, folder = sys.argv[1:]
if reader == "trimesh":
    import trimesh

    scene = trimesh.load(f"{folder}/result.glb")
    parts = list(scene.geometry.values())
    ply = trimesh.load(f"{folder}/result.ply", process=False)
    found = {
        "glb_triangles": sum(len(p.faces) for p in parts),
        "glb_up": float(max(p.vertices[:, 1].max() for p in parts)),
        "ply_vertices": len(ply.vertices),
        "ply_triangles": len(ply.faces),
        "ply_up": float(ply.vertices[:, 2].max()),
    }
elif reader == "open3d":
    import open3d

    glb, ply = (open3d.io.read_triangle_mesh(f"{folder}/result.{form}") for form in ("glb", "ply"))
    found = {
        "glb_triangles": len(glb.triangles),
        "glb_up": float(glb.get_max_bound()[1]),
        "ply_vertices": len(ply.vertices),
        "ply_triangles": len(ply.triangles),
        "ply_up": float(ply.get_max_bound()[2]),
    }
else:
    import pycolmap

    model = pycolmap.Reconstruction(f"{folder}/colmap")
    image = next(iter(model.images.values()))
    found = {
        "images": len(model.images),
        "cameras": len(model.cameras),
        "width": model.cameras[image.camera_id].width,
        "center": list(image.projection_center()),
    }
print(json.dumps(found))
