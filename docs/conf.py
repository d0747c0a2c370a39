"""How Sphinx makes a site of these pages: offline, and strict about what leads nowhere."""

import sys
from pathlib import Path

import curricle

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reference import write_pages  # noqa: E402 (found where the line above has Python look)

project = html_title = "Curricle"
version = release = curricle.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "reference",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
templates_path = ["_templates"]
myst_heading_anchors = 4  # so that links to headings lead somewhere, or the build fails
reference_packages = [
    f"curricle.{name}"
    for name in (
        *("tasks", "learning", "planning", "transfer", "curriculum", "certificate"),
        *("candidates", "comparison", "statistics", "study", "pictures", "show"),
        *("interop", "deep", "errors"),
    )
]
write_pages(reference_packages, HERE / "api")  # read by the extensions below

# Docstrings say types in words, and arrays with their shapes.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]

# Nothing is fetched, so Python's own names lead nowhere. The others are real and not public.
nitpicky = True
nitpick_ignore_regex = [
    ("py:class", r"ValueError|Exception|concurrent\.futures\._base\.BrokenExecutor"),
    ("py:exc", r"pydantic\.ValidationError"),
    ("py:class", "Arms|FactoredModel"),
    ("py:func", "shared_limits|arm_styles"),
]

html_theme = "furo"
html_copy_source = html_show_sourcelink = html_show_copyright = False
