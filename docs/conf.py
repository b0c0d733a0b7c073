"""The documentation site: python -m sphinx -W -b html docs build/docs  (extra ``docs``)."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from make_schemas import write_schemas  # noqa: E402

import isetval  # noqa: E402

project = "isetval"
author = "The isetval engineers"
release = isetval.__version__
write_schemas()
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "effect_pages",
]
exclude_patterns = ["gallery"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
# links of architecture.md that lead out of the site, and headings of generated pages that begin at the second level
suppress_warnings = ["myst.header", "myst.xref_missing", "config.cache", "toc.not_included", "toc.multiple_toc_parents"]
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
autosummary_generate = True
autodoc_typehints = "none"
nitpicky = False
html_theme = "alabaster"
html_theme_options = {
    "description": "a ruler and a detective for camera models",
    "fixed_sidebar": True,
    "page_width": "1120px",
    "sidebar_width": "240px",
}
html_static_path = ["static"]
html_css_files = ["small_screens.css"]
html_show_copyright = False
html_extra_path = ["schema"]
sphinx_gallery_conf = {
    "examples_dirs": str(HERE / "gallery"),
    "gallery_dirs": "auto_gallery",
    "filename_pattern": "plot_",
    "remove_config_comments": True,
    "show_memory": False,
    "download_all_examples": False,
    "min_reported_time": 5,
    "plot_gallery": "True",
}
