"""Writes 48 panoramas of a day and a night, 000.hdr to 047.hdr: python3 panoramas.py FOLDER."""

import math
import os
import struct
import sys

WIDTH, HEIGHT, FRAMES = 128, 64, 48


def mix(a, b, t):
    t = min(max(t, 0.0), 1.0)
    return [x + (y - x) * t for x, y in zip(a, b)]


def lamp(d, at, width, color):
    """A round lamp with a soft rim; `color` is its radiance."""
    cos = sum(x * y for x, y in zip(d, at))
    return [c * math.exp((cos - 1) / (width * width)) for c in color]


def towards(azimuth, elevation):
    a, e = math.radians(azimuth), math.radians(elevation)
    return [math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)]


def radiance(d, time):
    """Light from the direction d; time 0 is sunrise, 0.6 sunset, then two lamps shine until 1."""
    day = time / 0.6
    height = math.sin(math.pi * day) if day < 1 else -0.3
    bright = min(max(height + 0.15, 0.0), 1.0)
    dusk = max(0.0, 1 - abs(height) / 0.35)
    sky = mix([0.45, 0.62, 1.0], [0.12, 0.25, 0.75], max(d[2], 0))
    sky = mix(sky, [1.0, 0.45, 0.2], dusk * max(0.0, 1 - abs(d[2]) * 2))
    sky = [0.02 + 0.5 * bright * x for x in sky] if d[2] > 0 else [0.015 + 0.5 * bright * x for x in [0.22, 0.2, 0.15]]
    parts = [sky]
    if day < 1:
        sun = towards(60 + 240 * day, 3 + 65 * height)
        parts.append(lamp(d, sun, 0.07, [25 * bright * x for x in mix([1, 0.95, 0.85], [1, 0.45, 0.15], dusk)]))
    else:
        turn = 360 * (time - 0.6)
        parts.append(lamp(d, towards(90 + turn, 35), 0.2, [5.0, 1.2, 0.3]))
        parts.append(lamp(d, towards(250 + turn, 25), 0.2, [0.2, 0.9, 5.0]))
    return [sum(x) for x in zip(*parts)]


def rgbe(color):
    top = max(color)
    if top < 1e-9:
        return bytes(4)
    mantissa, exponent = math.frexp(top)
    return bytes(int(c * mantissa * 256 / top) for c in color) + bytes([exponent + 128])


folder = sys.argv[1]
os.makedirs(folder, exist_ok=True)
for frame in range(FRAMES):
    pixels = bytearray()
    for y in range(HEIGHT):
        theta = math.pi * (y + 0.5) / HEIGHT
        for x in range(WIDTH):
            a = 2 * math.pi * (x + 0.5) / WIDTH
            d = [math.sin(theta) * math.sin(a), math.sin(theta) * math.cos(a), math.cos(theta)]
            pixels += rgbe(radiance(d, frame / FRAMES))
    with open(f"{folder}/{frame:03}.hdr", "wb") as file:
        file.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (HEIGHT, WIDTH) + pixels)
