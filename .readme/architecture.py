"""Writes architecture.svg beside itself: the data flow from the sensor to pictures. python3 architecture.py"""

import pathlib

WIDTH, ROW, BOX, GAP, LEFT = 1120, 62, 42, 14, 150
# Lane: title, process, colour, boxes (text, note, whether it is a file).
LANES = [
    ("capture", "process 1", "#dbeafe", [
        ("USB", "isochronous", False), ("packets", "assembler", False), ("depth, Bayer", "unpack, register", False),
        ("recording.lrec", "or TUM folder; optional", True), ("pairs", "nearest in time", False)]),
    ("fusion", "process 1", "#dcfce7", [
        ("filter, pyramid", "", False), ("track", "ICP + photometric", False), ("integrate", "TSDF blocks", False),
        ("keyframes", "Eq. (1)", False), ("mesh", "marching cubes", False), ("scan.lscan", "", True)]),
    ("estimator", "process 2, its child", "#fef3c7", [
        ("regularise", "§3.1", False), ("associate", "Eqs. (2)–(5)", False), ("segment", "Eqs. (6), (7)", False),
        ("transfer", "Eq. (8)", False), ("factorise", "Eqs. (9)–(12)", False), ("specular", "Eq. (13)", False),
        ("validate", "held-out frames", False), ("result.lres", "", True)]),
    ("outputs", "", "#fce7f3", [
        ("export", "GLB, PLY, HDR, COLMAP …", False), ("render", "insert, remove, relight", False),
        ("preview.png", "", True), ("viewer.html", "", True)]),
]


def lane(index, title, process, colour, boxes):
    y = 20 + index * (ROW + 34)
    parts = [f'<rect x="8" y="{y - 10}" width="{WIDTH - 16}" height="{ROW}" rx="8" fill="{colour}"/>',
             f'<text x="24" y="{y + (18 if process else 26)}" class="lane">{title}</text>',
             f'<text x="24" y="{y + 36}" class="process">{process}</text>']
    width = (WIDTH - LEFT - 24 - GAP * (len(boxes) - 1)) / len(boxes)
    for i, (text, note, is_file) in enumerate(boxes):
        x = LEFT + i * (width + GAP)
        style = ' stroke-width="2.5"' if is_file else ""
        parts.append(f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{BOX}" rx="5" class="box"{style}/>')
        middle = x + width / 2
        parts.append(f'<text x="{middle:.0f}" y="{y + (18 if note else 25)}" class="name">{text}</text>')
        if note:
            parts.append(f'<text x="{middle:.0f}" y="{y + 34}" class="note">{note}</text>')
        if i and title != "outputs":
            parts.append(f'<path d="M{x - GAP:.0f} {y + 21} h{GAP - 2}" class="arrow"/>')
    if index:
        parts.append(f'<path d="M1030 {y - ROW - 34 + BOX} v24 H{LEFT + width / 2:.0f} v{ROW + 8 - BOX}" class="arrow"/>')
    return parts


def main():
    height = 20 + len(LANES) * (ROW + 34) - 20
    svg = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">',
           '<style>.lane{font-size:16px;font-weight:bold}.name{font-size:13px;text-anchor:middle}'
           '.process{font-size:10.5px;fill:#555}.note{font-size:10.5px;text-anchor:middle;fill:#555}.box{fill:#fff;stroke:#333}'
           '.arrow{fill:none;stroke:#333;stroke-width:1.5;marker-end:url(#a)}</style>',
           '<defs><marker id="a" markerWidth="8" markerHeight="8" refX="6" refY="3" orient="auto">'
           '<path d="M0 0 L6 3 L0 6 z" fill="#333"/></marker></defs>',
           f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>']
    for index, row in enumerate(LANES):
        svg += lane(index, *row)
    svg.append("</svg>")
    pathlib.Path(__file__).with_name("architecture.svg").write_text("\n".join(svg) + "\n", encoding="utf-8")


main()
