"""Run the notebooks: each script `N-name.py` (jupytext percent format) into `N-name.ipynb` with its outputs.

python notebooks/make.py                        # all, at full length, outputs kept beside the scripts
python notebooks/make.py 3-hard-cases --fast --out /tmp   # one, short, somewhere else
python notebooks/make.py 8-longline --texts     # new words between the cells; nothing is run
"""

from __future__ import annotations

import argparse
import base64
import io
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import jupytext
import nbclient
import nbformat
from PIL import Image

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from short import shortened  # noqa: E402

#: Longest cell [s].
TIMEOUT = 1200
#: Width [pixel] and colours of the pictures kept.
WIDEST, COLOURS = 860, 255


def scripts() -> list[Path]:
    """All notebooks' scripts in order."""
    return sorted(HERE.glob("[0-9]*-*.py"), key=lambda script: int(script.name.partition("-")[0]))


def execute(script: Path, fast: bool) -> Any:
    """The notebook of a script with its outputs, run in an empty folder.

    Raises:
        nbclient.exceptions.CellExecutionError: of the first cell that fails.
    """
    notebook = jupytext.read(script)
    notebook.metadata["kernelspec"] = {"display_name": "Python 3", "language": "python", "name": "python3"}
    settings = dict(os.environ)
    if fast:
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        for cell, text in zip(code, shortened(script.stem, [cell.source for cell in code]), strict=True):
            cell.source = text or "pass  # left out of short runs"
        settings["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # not worth an optimised program
    with tempfile.TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        # one output for all prints of a cell, however slowly they come
        client = nbclient.NotebookClient(
            notebook, timeout=TIMEOUT, kernel_name="python3", resources=where, coalesce_streams=True
        )
        client.execute(env=settings)
    return tidy(notebook)


def retold(script: Path) -> Any:
    """The kept notebook with the texts that the script has now; its code must be the same.

    Raises:
        ValueError: the code has changed as well.
    """
    kept, fresh = nbformat.read(script.with_suffix(".ipynb"), 4), jupytext.read(script)
    code = [[cell for cell in each.cells if cell.cell_type == "code"] for each in (kept, fresh)]
    if [cell.source for cell in code[0]] != [cell.source for cell in code[1]]:
        raise ValueError(f"{script.stem}: its code has changed; run it")
    for old, new in zip(*code, strict=True):
        new["outputs"], new["execution_count"] = old.outputs, old.execution_count
    fresh.metadata = kept.metadata
    return tidy(fresh)


def tidy(notebook: Any) -> Any:
    """Without what differs from one execution to the next although nothing changed."""
    for i, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output["data"]["image/png"] = smaller(output["data"]["image/png"])
        cell["id"] = f"cell-{i}"
        cell.metadata.pop("execution", None)
        cell["outputs"] = (
            [out for out in cell.get("outputs", []) if out.get("name") != "stderr"] if "outputs" in cell else []
        )
        if cell.cell_type != "code":
            cell.pop("outputs", None)
    notebook.metadata.pop("language_info", None)
    return notebook


def smaller(png: str) -> str:
    """A picture in base64 with few colours and no more pixels than a page shows."""
    with Image.open(io.BytesIO(base64.b64decode(png))) as image:
        flat = Image.new("RGB", image.size, "white")
        flat.paste(image, mask=image.getchannel("A") if image.mode == "RGBA" else None)
    flat.thumbnail((WIDEST, WIDEST), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    # by coverage of the colour space, not by number of pixels: thin lines keep their colours
    flat.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(data, "PNG", optimize=True)
    return base64.b64encode(data.getvalue()).decode()


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Run notebooks.")
    parser.add_argument("names", nargs="*", help="such as 3-hard-cases (default: all)")
    parser.add_argument("--fast", action="store_true", help="short runs")
    parser.add_argument("--texts", action="store_true", help="take texts only, run nothing")
    parser.add_argument("--out", type=Path, default=HERE, help="folder of the results (default: beside the scripts)")
    args = parser.parse_args(argv)
    for script in scripts():
        if args.names and script.stem not in args.names:
            continue
        try:
            notebook = retold(script) if args.texts else execute(script, args.fast)
        except nbclient.exceptions.CellExecutionError as error:
            print(f"{script.stem}: {error.ename}: {error.evalue}", file=sys.stderr)
            return 1
        path = args.out / f"{script.stem}.ipynb"
        nbformat.write(notebook, path)
        print(f"{script.stem}: {path.stat().st_size / 1000:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
