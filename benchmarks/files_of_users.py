"""Does the first command answer, on files as users bring them? Truth by SciPy, without this project's code.

    python benchmarks/files_of_users.py [--seeds 0:40] [--out FILE] [--folder DIR]

Of every four draws three are determinable, and one lacks a number or is driven throughout. A file has a style (log of
an encoder, tracker, film), a language of its header, separators and decimals, units, a rate, a start that is free,
held or driven, noise and rounding. `dropper fit FILE` gets nothing else. A row is right if every value lies within
three standard errors, lengths and the best determined damping also within 5 %; a draw that is not determinable is right
if the command refuses it in one line with what to give. Written are also rows that are wrong and `ok`. Writes
results/files_of_users.json.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from study import RESULTS, Found, collect, columns, command, joined, table_of

GRAVITY = 9.81
STYLES = ("encoder", "logger", "steps", "point", "film", "chain", "markers")
LACKS = ("frames", "counts", "lengths", "driven", "pushed", "still", "motor", "which", "one_column", "text")
#: Part of the message that names what to give or do.
HINTS = {
    "frames": "--rate",
    "counts": "--counts",
    "lengths": "--lengths",
    "driven": "free swing",
    "pushed": "free swing",
    "still": "motion",
    "motor": "free swing",
    "which": "--columns",
    "one_column": "time",
    "text": "CSV",
}
TIMES = ("t", "time", "Zeit", "temps", "tiempo", "tempo", "timestamp", "czas")
ANGLES = ("theta", "angle", "Winkel", "angolo", "ángulo", "phi", "Vinkel", "encoder")


@dataclass(frozen=True)
class Truth:
    """A chain of one or two point masses: lengths [m], mass of the second over the first, drag per first mass."""

    lengths: tuple[float, ...]
    ratio: float
    b_l: float
    b_q: float


@dataclass
class File:
    """A file as text, and the truth of what it shows.

    Attributes:
        zero: reading at rest [rad], None where points have none.
    """

    text: str
    truth: Truth
    zero: float | None
    about: dict[str, str] = field(default_factory=dict)


def swing(truth: Truth, start: np.ndarray, t: np.ndarray, push: Callable[[float], float] | None = None) -> np.ndarray:
    """Angles (k, n) from straight down at times t (k,), released at rest from `start` (n,)."""
    n = len(start)
    mass = np.array([1.0, truth.ratio])[:n]
    length = np.array(truth.lengths)
    below = np.tril(np.ones((n, n)))

    def slope(now: float, y: np.ndarray) -> np.ndarray:
        phi = y[:n]
        rate = y[n:]
        jacobian = np.stack([below * length * np.cos(phi), below * length * np.sin(phi)])  # (2, nodes, n)
        turning = np.stack([below @ (-length * np.sin(phi) * rate**2), below @ (length * np.cos(phi) * rate**2)])
        v = jacobian @ rate
        speed = np.hypot(*v)
        force = -(truth.b_l + truth.b_q * speed) * v - mass * turning
        force[1] -= mass * GRAVITY
        matrix = np.einsum("cik,i,cil->kl", jacobian, mass, jacobian)
        loads = np.einsum("cik,ci->k", jacobian, force)
        if push is not None:
            loads[0] += push(now)
        return np.concatenate([rate, np.linalg.solve(matrix, loads)])

    y0 = np.concatenate([start, np.zeros(n)])
    return solve_ivp(slope, (0.0, float(t[-1]) + 1e-9), y0, method="DOP853", t_eval=t, rtol=1e-9, atol=1e-10).y[:n].T


def with_start(
    truth: Truth, start: np.ndarray, rate: float, duration: float, kind: str, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Times (k,) and angles (k, n): a free swing, after a hand has held the chain or has moved it."""
    t = np.arange(round(duration * rate)) / rate
    if kind == "free":
        late = 0.3 * rng.random()  # the recording starts after the release
        fine = np.concatenate([[0.0], t + late])
        return t, swing(truth, start, fine)[1:]
    period = 2 * np.pi * np.sqrt(truth.lengths[0] / GRAVITY)
    before = (0.8 + 1.5 * rng.random()) * period
    early = t[t < before]
    later = t[t >= before]
    sway = 0.004 * np.sin(9.0 * early)
    if kind == "driven":
        # the hand moves the chain to and fro, and is at rest when it releases it
        left = before - early
        sway = -0.5 * start[0] * (1 - np.cos(2 * np.pi * left / (0.63 * period))) * (left < 0.63 * period * 2)
    hand = start[None, :] + sway[:, None]
    fine = np.concatenate([[0.0], later - before])
    return t, np.concatenate([hand, swing(truth, start, fine)[1:]])


def text_of(rows: np.ndarray, head: list[str], digits: list[int], rng: np.random.Generator, comments: list[str]) -> str:
    """Rows (k, columns) as text in a random style; a missing value is empty."""
    comma = rng.random() < 0.35
    if comma:
        separator = str(rng.choice([";", "\t"]))
    else:
        separator = str(rng.choice([",", ";", "\t", "  "]))

    def cell(value: float, places: int) -> str:
        if np.isnan(value):
            if separator == "  ":
                return "nan"
            return ""
        text = f"{value:.{places}f}"
        if comma:
            return text.replace(".", ",")
        return text

    if separator == "  ":
        head = [name.replace(" ", "_") for name in head]
    lines = [*comments, separator.join(head)]
    lines += [separator.join(cell(v, d) for v, d in zip(row, digits, strict=True)) for row in rows]
    return "\n".join(lines) + "\n"


def single(rng: np.random.Generator) -> tuple[Truth, np.ndarray, float]:
    """A pendulum, its release and its period [s]."""
    length = float(10 ** rng.uniform(-1.0, 0.2))
    period = 2 * np.pi * np.sqrt(length / GRAVITY)
    b_l = float(10 ** rng.uniform(-2.3, -1.5)) * 4 * np.pi / period
    start = float(rng.uniform(0.45, 1.3)) * rng.choice([-1, 1])
    speed = abs(start) * np.sqrt(GRAVITY * length)
    b_q = b_l / speed * float(rng.uniform(0.5, 2.0))
    return Truth((length,), 0.0, b_l, b_q), np.array([start]), period


def clock_columns(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, str, int]:
    """Times in a unit, the column's name and its digits."""
    name = str(rng.choice(TIMES))
    unit = str(rng.choice(["s", "ms", ""]))
    begin = float(rng.choice([0.0, 0.0, 12.5, 1700.0]))
    if unit == "ms":
        shown = str(rng.choice([f"{name} [ms]", f"{name}_ms", name]))
        return 1e3 * (t + begin), shown, 1
    shown = f"{name} (s)" if unit else name
    return t + begin, shown, 5


def encoder_file(rng: np.random.Generator, style: str) -> File:
    """An angle against time: sampled, uneven as a logger, or a row at each step."""
    truth, start, period = single(rng)
    kind = str(rng.choice(["free", "held", "driven"]))
    rate = float(rng.uniform(60, 900)) / max(period, 0.7)
    duration = period * rng.uniform(18, 60)
    if style == "steps":
        rate = 4000.0 / period
    t, phi = with_start(truth, start, rate, duration, kind, rng)
    if rng.random() < 0.6:
        zero = float(rng.uniform(-0.06, 0.06))
    else:
        zero = float(rng.choice([1.0, 1.5708, 3.1]))
    reading = phi[:, 0] * rng.choice([-1, 1]) + zero
    degrees = rng.random() < 0.5
    step = float(2 * np.pi / rng.choice([1024, 2400, 4096, 8192, 20000]))
    if style == "steps":
        count = np.round(reading / step).astype(int)
        rows = np.flatnonzero(np.diff(count)) + 1
        t = t[rows]
        reading = count[rows] * step
    else:
        noise = float(10 ** rng.uniform(-4, -2.5))
        reading = np.round((reading + noise * rng.standard_normal(len(reading))) / step) * step
    wrapped = style == "encoder" and rng.random() < 0.3
    if wrapped:
        reading = reading % (2 * np.pi)
    shown, name, digits = clock_columns(t, rng)
    rows = np.stack([shown, np.degrees(reading) if degrees else reading], axis=1)
    if degrees:
        unit = str(rng.choice([" [deg]", "_deg", " (°)", ""]))
    else:
        unit = str(rng.choice([" [rad]", "_rad", ""]))
    head = [name, f"{rng.choice(ANGLES)}{unit}"]
    if style == "logger":
        keep = rng.random(len(rows)) > 0.1
        rows = rows[keep]
        again = np.sort(rng.choice(len(rows), 5, replace=False))
        rows = np.insert(rows, again, rows[again], axis=0)
        i = int(rng.integers(20, len(rows) - 20))
        rows[[i, i + 3]] = rows[[i + 3, i]]
        rows = np.column_stack([rows, 21.0 + 0.01 * np.round(rng.standard_normal(len(rows)))])
        head.append("temperature")
    comments = ["# pendulum in the lab"] if rng.random() < 0.3 else []
    text = text_of(rows, head, [digits, 6 if not degrees else 4, 2][: len(head)], rng, comments)
    return File(text, truth, zero, {"start": kind, "unit": "deg" if degrees else "rad", "wrapped": str(wrapped)})


def film_columns(t: np.ndarray, rate: float, rng: np.random.Generator) -> tuple[np.ndarray, str, int, list[str]]:
    """Times or frames of a film, with the rate in a comment."""
    if rng.random() < 0.5:
        return t, str(rng.choice(["t", "time (s)", "Zeit [s]"])), 4, []
    said = str(rng.choice([f"# fps = {rate:g}", f"# {rate:g} fps", f"# frame rate: {rate:g}"]))
    return np.round(t * rate), str(rng.choice(["frame", "Bild", "image"])), 0, [said]


def picture(nodes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, str, float, bool]:
    """Points (k, m, 2) [m] as a camera counts them: pixels downwards or lengths upwards; unit, metres per unit."""
    unit = str(rng.choice(["px", "m", "mm", "cm"]))
    size = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}.get(unit, 0.0)
    extent = float(np.abs(nodes).max())
    if unit == "px":
        size = extent / 700.0
    found = nodes / size
    found = found + 1e-6 * extent / size
    if unit == "px":
        found = np.array([960.0, 200.0]) + found * np.array([1.0, -1.0])
    else:
        found = found + extent / size * rng.uniform(-1, 1, 2)
    noise = float(10 ** rng.uniform(-3.6, -2.8)) * extent / size
    found = found + noise * rng.standard_normal(found.shape)
    return found, unit, size, unit == "px"


def point_file(rng: np.random.Generator, style: str) -> File:
    """Points of a pendulum or of a chain of two: one, two on one link, one per joint, two per link."""
    two = style in ("chain", "markers")
    rate = float(rng.choice([60.0, 119.88, 240.0]))
    if two:
        lengths = (float(rng.uniform(0.12, 0.35)), float(rng.uniform(0.12, 0.35)))
        ratio = float(rng.uniform(0.4, 1.8))
        b_l = float(10 ** rng.uniform(-1.3, -0.6))
        truth = Truth(lengths, ratio, b_l, b_l * float(rng.uniform(0.3, 1.5)))
        start = rng.uniform(0.4, 1.2) * rng.choice([-1, 1]) + 0.2 * rng.standard_normal(2)
        t, phi = with_start(truth, start, rate, float(rng.uniform(8, 14)), "free", rng)
        kind = "free"
    else:
        truth, start, period = single(rng)
        rate = max(rate, 40.0 / period)
        kind = str(rng.choice(["free", "held", "driven"]))
        t, phi = with_start(truth, start, rate, period * float(rng.uniform(20, 45)), kind, rng)
    roll = float(rng.uniform(-0.04, 0.04))
    angle = phi + roll
    each = zip(truth.lengths, angle.T, strict=True)
    links = np.stack([length * np.stack([np.sin(a), -np.cos(a)], axis=-1) for length, a in each], axis=1)
    joints = np.cumsum(links, axis=1)
    above = np.concatenate([np.zeros_like(joints[:, :1]), joints[:, :-1]], axis=1)
    if style == "point":
        nodes = joints
        if rng.random() < 0.4:
            nodes = np.concatenate([np.zeros_like(joints[:, :1]), joints], axis=1)
    elif style == "film" or style == "markers":
        near = rng.uniform(0.1, 0.4)
        far = rng.uniform(0.7, 1.0)
        nodes = np.stack([above + near * links, above + far * links], axis=2).reshape(len(t), -1, 2)
    else:
        nodes = joints
        if rng.random() < 0.5:
            nodes = np.concatenate([np.zeros_like(joints[:, :1]), joints], axis=1)
    seen, unit, _, _ = picture(nodes, rng)
    lost = rng.random(seen.shape[:2]) < 0.01
    seen[lost] = np.nan
    shown, name, digits, comments = film_columns(t, rate, rng)
    count = seen.shape[1]
    label = str(rng.choice(["x{}", "x_{}", "P{} x", "mass{}_x"]))
    named = unit if rng.random() < 0.6 else ""
    head = [name]
    for j in range(count):
        one = label.format(j + 1 if count > 1 else "").strip("_ ")
        for axis in "xy":
            if "mass" not in one:
                words = one.replace("x", axis)
            else:
                words = one.replace("_x", f"_{axis}")
            head.append(f"{words} [{named}]" if named else words)
    rows = np.column_stack([shown, seen.reshape(len(t), -1)])
    places = {"px": 2, "m": 5, "cm": 3, "mm": 2}[unit]
    text = text_of(rows, head, [digits, *[places] * (2 * count)], rng, comments)
    return File(text, truth, None, {"start": kind, "unit": unit, "points": str(count)})


def lacking_file(rng: np.random.Generator, lack: str) -> File:
    """A file that no program can answer: a number is missing, or it is driven throughout."""
    truth, start, period = single(rng)
    rate = 60.0 / period
    t = np.arange(round(30 * period * rate)) / rate
    phi = swing(truth, start, t)[:, 0]
    noise = 0.001 * rng.standard_normal(len(t))
    if lack == "driven":  # a motor turns it to and fro, with beats
        drive = 2 * np.pi / period * float(rng.uniform(0.85, 1.15))
        size = float(rng.uniform(0.1, 0.3)) * GRAVITY * truth.lengths[0]
        phi = swing(truth, np.array([0.0]), t, lambda now: size * np.sin(drive * now))[:, 0]
    if lack == "motor":  # moved by a motor alone
        phi = 0.6 * np.sin(2 * np.pi / period * float(rng.uniform(0.5, 1.5)) * t)
    if lack == "pushed":  # pushed again and again
        every = 3.3 * period
        size = 0.6 * GRAVITY * truth.lengths[0]
        phi = swing(truth, start, t, lambda now: size * (now % every < 0.2 * period))[:, 0]
    if lack == "still":
        phi = np.zeros(len(t))
        noise = 0 * noise
    reading = phi + noise
    rows = np.stack([t, reading], axis=1)
    head = ["t", "angle [rad]"]
    digits = [4, 5]
    if lack == "frames":
        rows = np.stack([np.arange(len(t)), reading], axis=1)
        head = ["frame", "angle [rad]"]
        digits = [0, 5]
    if lack == "counts":
        rows = np.stack([t, np.round(reading * 1303)], axis=1)
        head = ["t", "encoder [counts]"]
        digits = [4, 0]
    if lack == "lengths":
        chain = Truth((0.2, 0.15), 0.7, 0.05, 0.03)
        both = swing(chain, np.array([0.8, 0.6]), t)
        rows = np.column_stack([t, both])
        head = ["t", "angle 1 [rad]", "angle 2 [rad]"]
        digits = [4, 5, 5]
    if lack == "which":
        other = swing(truth, start * 0.6, t)[:, 0]
        rows = np.column_stack([t, reading, other])
        head = ["t", "ch_a", "ch_b"]
        digits = [4, 5, 5]
    if lack == "one_column":
        rows = reading[:, None]
        head = ["angle [rad]"]
        digits = [5]
    if lack == "text":
        text = "\0\1PK\3\4" * 100
    else:
        text = text_of(rows, head, digits, rng, [])
    return File(text, truth, None, {"lack": lack})


def draw(seed: int) -> tuple[str, File]:
    """The style and the file of a seed: every fourth lacks something."""
    rng = np.random.default_rng([seed, 592])
    if seed % 4 == 3:
        lack = LACKS[seed // 4 % len(LACKS)]
        return f"lacks {lack}", lacking_file(rng, lack)
    style = STYLES[(seed - seed // 4) % len(STYLES)]
    if style in ("encoder", "logger", "steps"):
        make = encoder_file
    else:
        make = point_file
    return style, make(rng, style)


def fit_file(path: Path) -> tuple[int, Found | None, str]:
    """Exit code, result and last line of the first command on a file."""
    run = subprocess.run(
        [sys.executable, "-m", "dropper_jax", "fit", path.name, "--quiet", "--json"],
        cwd=path.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in run.stderr.splitlines() if not line.startswith("warning")]
    try:
        found = json.loads(run.stdout)
    except json.JSONDecodeError:
        found = None
    return run.returncode, found, lines[-1] if lines else ""


def judged(found: Found, file: File) -> dict[str, tuple[float, float]]:
    """By value, the error in standard errors and relative to the truth (not a number where it has no size)."""
    truth = file.truth
    values = found["found"]
    right: dict[str, float] = {}
    if len(truth.lengths) == 1:
        right["effective length"] = truth.lengths[0]
        right["b_l / m"], right["b_q / m"] = truth.b_l, truth.b_q
    else:
        right |= {f"length {j + 1}": length for j, length in enumerate(truth.lengths)}
        right |= {"mass 2 over mass 1": truth.ratio, "b_l / mass 1": truth.b_l, "b_q / mass 1": truth.b_q}
    errors = {}
    for name, value in right.items():
        if name not in values:
            errors[name] = (np.inf, np.inf)
            continue
        one = values[name]
        error = one["value"] - value
        spread = one["std_error"] or np.nan
        if "length" in name or "mass 2" in name:
            relative = error / value
        else:
            relative = np.nan
        errors[name] = (float(error / spread), float(relative))
    if file.zero is not None:
        off = (values["angle at rest"]["value"] - file.zero + np.pi) % (2 * np.pi) - np.pi
        errors["zero"] = (float(off / (values["angle at rest"]["std_error"] or np.nan)), np.nan)
    best = found.get("best_determined")
    if best:
        speed = best["speed_m_per_s"]
        size = truth.b_l + speed * truth.b_q
        error = best["value"] - size
        errors["best damping"] = (float(error / best["std_error"]), float(error / size))
    return errors


def is_right(errors: dict[str, tuple[float, float]]) -> bool:
    """Whether all values lie within three errors, those with a size within 5 %."""
    near = all(abs(z) < 3.0 for z, _ in errors.values())
    return near and all(not abs(relative) > 0.05 for _, relative in errors.values())


def measure(seed: int, folder: Path) -> Found:
    """A row."""
    style, file = draw(seed)
    path = folder / f"measured-{seed}.csv"
    path.write_text(file.text, encoding="utf-8")
    started = time.perf_counter()
    code, found, last = fit_file(path)
    row = {"seed": seed, "style": style, **file.about, "rows": file.text.count("\n"), "code": code, "message": last}
    row["seconds"] = round(time.perf_counter() - started, 1)
    if "lack" in file.about:
        refused = code == 2 and HINTS[file.about["lack"]] in last and "\n" not in last
        return row | {"status": "refused" if code == 2 else str(found and found["status"]), "right": refused}
    if found is None or "found" not in found:
        return row | {"status": "refused", "right": False}
    errors = judged(found, file)
    right = is_right(errors) and found["status"] == "ok"
    z = {name: [round(one, 2), round(relative, 4)] for name, (one, relative) in errors.items()}
    wrong = found["status"] == "ok" and not right
    return row | {"status": found["status"], "right": right, "wrong_and_ok": wrong, "errors": z}


@table_of("files_of_users")
def files_of_users(found: Found) -> list[tuple[str, ...]]:
    """Rows by style."""
    rows = []
    draws = found["draws"]
    for style in dict.fromkeys(row["style"].split()[0] for row in draws):
        mine = [row for row in draws if row["style"].split()[0] == style]
        rows.append(
            {
                "style": style,
                "draws": len(mine),
                "right": sum(row["right"] for row in mine),
                "wrong": sum(row.get("wrong_and_ok", False) for row in mine),
                "seconds": [float(np.median([row["seconds"] for row in mine]))],
            }
        )
    seconds = lambda row: joined(row["seconds"], "{:.0f}")  # noqa: E731
    return columns(
        rows,
        ("file", "{style}"),
        ("draws", "{draws}"),
        ("right at the first command", "{right}"),
        ("wrong and `ok`", "{wrong}"),
        ("median time [s]", seconds),
    )


def every_row(seeds: range, folder: Path | None) -> Iterator[Found]:
    """Rows of all seeds."""
    with tempfile.TemporaryDirectory() as own:
        for seed in seeds:
            yield measure(seed, folder or Path(own))


@command(seeds="0:40", out=RESULTS / "files_of_users.json", folder="")
def main(args) -> None:
    folder = Path(args.folder) if args.folder else None
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
    seeds = range(*map(int, args.seeds.split(":")))
    collect(args.out, {"draws": every_row(seeds, folder)}, by="seed")
