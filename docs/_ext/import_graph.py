"""``{import-graph} PACKAGE``: which folders import from which, read from the code by every build.

The order is that of the contracts in pyproject.toml, under tool.importlinter, which lint checks.
"""

import ast
import tomllib
from pathlib import Path

import grimp
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

ROOT = "napari_defocus"
PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
SOURCE = Path(__file__).parents[2] / "src"

ROW, LEFT, NAME, GAP = 34, 60, 120, 12
"""px: the height of a row, the space for arrows against the order, the width of a name, a gap."""


class ImportGraph(SphinxDirective):
    """A drawing of the arrows, and a table of what each folder holds and imports."""

    required_arguments = 1

    def run(self):
        """Read the order and the imports anew: both may have changed since the last build."""
        package = self.arguments[0]
        self.env.note_reread()
        graph = grimp.build_graph(ROOT, cache_dir=None)
        rooms = [name for name in layers_of(package) if f"{package}.{name}" in graph.modules]
        imports = {room: imported_rooms(graph, package, room, rooms) for room in rooms}
        drawing = nodes.raw("", drawn(rooms, imports), format="html")
        return [drawing, *self.parse_text_to_nodes(table(package, rooms, imports))]


def layers_of(package):
    """Return the names in the layers contract of a package, from the top down."""
    contracts = tomllib.loads(PYPROJECT.read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    [layers] = [each["layers"] for each in contracts if each.get("containers") == [package]]
    return [name.strip(" ()") for layer in layers for name in layer.split("|")]


def imported_rooms(graph, package, room, rooms):
    """Return the other rooms that modules of a room import from, from the top down."""
    whole = f"{package}.{room}"
    modules = {whole, *graph.find_descendants(whole)}
    found = {name for each in modules for name in graph.find_modules_directly_imported_by(each)}
    return [
        other
        for other in rooms
        if other != room and any(f"{name}.".startswith(f"{package}.{other}.") for name in found)
    ]


def table(package, rooms, imports):
    """Return a table in Markdown, also for those who do not see the drawing."""
    rows = [
        f"| `{room}` | {idea_of(package, room)} | {', '.join(imports[room]) or 'nothing'} |"
        for room in rooms
    ]
    return "\n".join(["| | holds | imports from |", "|---|---|---|", *rows])


def idea_of(package, room):
    """Return the first paragraph of a docstring."""
    path = SOURCE.joinpath(*package.split("."), room)
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(path.read_text("utf-8")))
    return " ".join(text.split("\n\n")[0].split())


def drawn(rooms, imports):
    """Return an SVG: rooms one below the other, an arc for each import that no other implies.

    Arcs against the order are on the left, all of them.
    """
    row = {room: number for number, room in enumerate(rooms)}
    below = {room: [other for other in imports[room] if row[other] > row[room]] for room in rooms}
    arcs, longest = [], 0
    for room in rooms:
        for other in imports[room]:
            if row[other] < row[room]:
                arcs.append(arc(row[room], row[other], LEFT - GAP, -1))
            elif not any(leads_to(below, middle, other) for middle in below[room]):
                arcs.append(arc(row[room], row[other], LEFT + NAME + GAP, 1))
                longest = max(longest, row[other] - row[room])
    names = [
        f'<text x="{LEFT + NAME / 2}" y="{center(number) + 5}">{room}</text>'
        f'<rect x="{LEFT}" y="{center(number) - 13}" width="{NAME}" height="26" rx="4"/>'
        for room, number in row.items()
    ]
    width, height = LEFT + NAME + 2 * GAP + longest * ROW // 2, ROW * len(rooms)
    marker = (
        '<marker id="arrowhead" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7"'
        ' markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z"/></marker>'
    )
    label = "Each folder imports from those that its arrows lead to."
    return (
        f'<svg class="import-graph" viewBox="0 0 {width} {height}" width="{width}" role="img"'
        f' aria-label="{label}"><defs>{marker}</defs>{"".join(arcs + names)}</svg>'
    )


def leads_to(below, room, other):
    """Tell whether a room imports another by way of a third one."""
    return other in below[room] or any(leads_to(below, each, other) for each in below[room])


def arc(start, end, x, side):
    """Return an arc from a row to another, on the right (1) or on the left (-1)."""
    reach = abs(end - start) * ROW / 2
    if side < 0:
        reach = min(reach, LEFT - 2 * GAP)
    # A cubic reaches three quarters as far as its control points.
    turn = x + side * reach * 4 / 3
    top, bottom = center(start), center(end)
    path = f"M{x} {top}C{turn:.0f} {top} {turn:.0f} {bottom} {x} {bottom}"
    return f'<path class="{"down" if side > 0 else "up"}" d="{path}"/>'


def center(number):
    """Return the height of the middle of a row."""
    return number * ROW + ROW / 2


def setup(app):
    """Add the directive."""
    app.add_directive("import-graph", ImportGraph)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
