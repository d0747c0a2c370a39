"""Execute notebooks and store them with small outputs that are the same everywhere.

python examples/notebooks/store_outputs.py [NAME.ipynb ...]
"""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
LARGEST = 60_000
"""Characters of one output, at most: larger ones are left out."""
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def executed(path):
    """Return a notebook whose cells have been executed, in its own folder."""
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=1200, kernel_name="python3").execute(cwd=str(path.parent))
    return stripped(notebook)


def stripped(notebook):
    """Return a notebook without what differs between machines: times, bars, metadata."""
    number = 0
    for cell in notebook.cells:
        cell.metadata = {}
        if cell.cell_type != "code":
            continue
        number += 1
        cell.execution_count = number
        cell.outputs = [one for one in cell.outputs if _kept(one)]
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = number
    notebook.metadata = {"kernelspec": KERNEL}
    return notebook


def _kept(output):
    if output.output_type == "stream":
        return output.name == "stdout"
    if output.output_type == "error":
        return True
    shown = output.data.get("text/html", output.data["text/plain"])
    return bool(shown) and len(str(output.data)) <= LARGEST


def main(names):
    for path in [FOLDER / name for name in names] or sorted(FOLDER.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(f"{path.name}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
