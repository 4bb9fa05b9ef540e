"""Writes knot.glb (orange clay) and ball.glb (a mirror), 10 cm high, standing on the origin: python3 objects.py FOLDER."""

import json
import math
import struct
import sys


def glb(path, points, normals, triangles, color, metallic, roughness):
    low = [min(p[k] for p in points) for k in range(3)]
    high = [max(p[k] for p in points) for k in range(3)]
    data = b"".join(struct.pack("<3f", *p) for p in points + normals)
    data += b"".join(struct.pack("<3I", *t) for t in triangles)
    n, f = len(points), len(triangles)
    view = lambda at, size, target: {"buffer": 0, "byteOffset": at, "byteLength": size, "target": target}
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}]}],
        "materials": [{
            "pbrMetallicRoughness": {
                "baseColorFactor": [*color, 1], "metallicFactor": metallic, "roughnessFactor": roughness,
            },
        }],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5126, "count": n, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5125, "count": 3 * f, "type": "SCALAR"},
        ],
        "bufferViews": [view(0, 12 * n, 34962), view(12 * n, 12 * n, 34962), view(24 * n, 12 * f, 34963)],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data)


def sweep(rows, columns, surface):
    """A closed surface of rows × columns points; its normals from differences. +Y is up."""
    points = [surface(i / rows, j / columns) for i in range(rows) for j in range(columns)]
    sub = lambda a, b: [x - y for x, y in zip(a, b)]
    normals = []
    for i in range(rows):
        for j in range(columns):
            at = lambda di, dj: points[(i + di) % rows * columns + (j + dj) % columns]
            a, b = sub(at(1, 0), at(-1, 0)), sub(at(0, 1), at(0, -1))
            n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
            length = math.hypot(*n) or 1
            normals.append([x / length for x in n])
    triangles = []
    for i in range(rows):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            c, d = (i + 1) % rows * columns + j, (i + 1) % rows * columns + (j + 1) % columns
            triangles += [[a, c, b], [b, c, d]]
    return points, normals, triangles


def knot(u, v):
    """A trefoil in a tube."""
    line = lambda t: [math.sin(t) + 2 * math.sin(2 * t), math.cos(t) - 2 * math.cos(2 * t), -math.sin(3 * t)]
    t, tube = 2 * math.pi * u, -2 * math.pi * v
    p, q = line(t), line(t + 1e-4)
    along = [(b - a) / 1e-4 for a, b in zip(p, q)]
    length = math.hypot(*along)
    along = [x / length for x in along]
    side = [along[1], -along[0], 0.0]
    length = math.hypot(*side)
    side = [x / length for x in side]
    up = [along[1] * side[2] - along[2] * side[1], along[2] * side[0] - along[0] * side[2], along[0] * side[1] - along[1] * side[0]]
    x, y, z = (a + 0.55 * (math.cos(tube) * s + math.sin(tube) * n) for a, s, n in zip(p, side, up))
    return [0.0155 * x, 0.0155 * (y + 3.45), 0.0155 * z]


def ball(u, v):
    a, b = math.pi * (u + 0.002) * 0.998, -2 * math.pi * v
    return [0.05 * math.sin(a) * math.cos(b), 0.05 + 0.05 * math.cos(a), 0.05 * math.sin(a) * math.sin(b)]


folder = sys.argv[1]
glb(f"{folder}/knot.glb", *sweep(180, 20, knot), [0.7, 0.25, 0.08], 0.0, 1.0)
points, _, triangles = sweep(48, 64, ball)
normals = [[p[0] / 0.05, p[1] / 0.05 - 1, p[2] / 0.05] for p in points]
triangles = triangles[: 2 * 47 * 64]
glb(f"{folder}/ball.glb", points, normals, triangles, [0.95, 0.95, 0.95], 1.0, 0.0)
