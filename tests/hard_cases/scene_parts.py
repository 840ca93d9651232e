"""Parts of scenes as plain tables, one line each."""

from typing import Any


def fixed(name: str, *position: float, **more: Any) -> dict[str, Any]:
    """A point that does not move."""
    return {"name": name, "position": list(position), **more}


def free(name: str, *position: float, **more: Any) -> dict[str, Any]:
    """A point that moves with its lines."""
    return {"name": name, "kind": "free", "position": list(position), **more}


def line_of(name: str, start: str, end: str, links: int, length: Any, **more: Any) -> dict[str, Any]:
    """A line between two points; the length [m] is its own with a `type`, else that of a link."""
    return {"name": name, "from": start, "to": end, "links": links, "length": length, **more}


def system(
    points: list[dict[str, Any]], lines: list[dict[str, Any]], *, dt: float = 0.01, duration: float = 1.0, **more: Any
) -> dict[str, Any]:
    """A scene of points and lines, under weight alone if nothing else is given."""
    run = {"dt": dt, "duration": duration}
    return {"run": run, "point": points, "line": lines, "effects": {"weight": {}}, **more}


def free_at(position: list[float], **body: Any) -> dict[str, Any]:
    """A free point of `scene_of`."""
    return {"kind": "free", "position": position, **body}


def scene_of(points: dict[str, Any], *lines: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """A scene of points by name, positions of fixed ones or `free_at` ones, and lines; by default with weight alone."""
    listed = []
    for name, given in points.items():
        listed.append({"name": name, **(given if isinstance(given, dict) else {"position": given})})
    start = {"run": {"dt": 0.01, "duration": 0.1}, "point": listed, "line": list(lines), "effects": {"weight": {}}}
    return start | sections
