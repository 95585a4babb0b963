"""Sphinx configuration: `make docs` builds these pages into build/docs, with every warning an error."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))

project = "Facemime"
copyright = "Facemime maintainers"
release = tomllib.loads((HERE.parent / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "docstrings",
    "mathml",
    "repository",
]
templates_path = ["_templates"]
exclude_patterns = ["_*", "**/_*", "release/*"]
default_role = "literal"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"
add_module_names = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
# Attributes are looked up by their bare names, which several classes may have.
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_title = f"Facemime {release}"
html_theme_options = {"source_directory": "docs/", "navigation_with_keys": True}
html_copy_source = False
html_show_sphinx = False
