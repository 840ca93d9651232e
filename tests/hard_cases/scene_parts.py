"""Parts of scenes as plain tables, one line each."""

from typing import Any


def fixed(name: str, *position: float, **more: Any) -> dict[str, Any]:
    """A point that does not move."""
    return {"name": name, "position": list(position), **more}


def free(name: str, *position: float, **more: Any) -> dict[str, Any]:
    """A point that moves with its lines."""
    return {"name": name, "kind": "free", "position": list(position), **more}


def line(name: str, start: str, end: str, links: int, length: Any, **more: Any) -> dict[str, Any]:
    """A line between two points; the length [m] is its own with a `type`, else that of a link."""
    return {"name": name, "from": start, "to": end, "links": links, "length": length, **more}


def system(
    points: list[dict[str, Any]], lines: list[dict[str, Any]], *, dt: float = 0.01, duration: float = 1.0, **more: Any
) -> dict[str, Any]:
    """A scene of points and lines, under weight alone if nothing else is given."""
    run = {"dt": dt, "duration": duration}
    return {"run": run, "point": points, "line": lines, "effects": {"weight": {}}, **more}
