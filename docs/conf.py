"""How Sphinx builds the documentation: ``python3 tasks.py docs``. Nothing is fetched."""

import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER / "_ext"), str(FOLDER.parent / "src")]

import napari_defocus  # noqa: E402

project = "napari-defocus"
author = copyright = "napari-defocus maintainers"
version = release = napari_defocus.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "import_graph",
    "mathml",
    "public_names",
    "stale_pages",
    "terminal_reference",
]
root_doc = "index"
exclude_patterns = [
    "_build",
    "gallery",  # the scripts; their pages are in examples/
    "**/GALLERY_HEADER.rst",
    "examples/*/*.ipynb",
    "examples/*/*.py",
]
nitpicky = True
suppress_warnings = ["config.cache"]  # the gallery's scraper is a function

default_role = "public-name"
highlight_language = "none"
autosummary_generate = True
toc_object_entries_show_parents = "hide"
autodoc_typehints = "none"  # numpydoc's sections say them, in words
numpydoc_show_class_members = False
numpydoc_validation_checks: set[str] = set()
templates_path = ["_templates"]

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme = "pydata_sphinx_theme"
html_title = "napari-defocus"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
html_sidebars = {"start": []}
html_theme_options = {
    "logo": {"text": "napari-defocus"},
    "navbar_end": ["theme-switcher"],
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "footer_start": ["licence"],
    "footer_end": [],
    "show_toc_level": 2,
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}

sphinx_gallery_conf = {
    "examples_dirs": [f"gallery/{part}" for part in ("tasks", "parameters", "limits", "figures")],
    "gallery_dirs": [f"examples/{part}" for part in ("tasks", "parameters", "limits", "figures")],
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "capture_repr": (),
    "download_all_examples": False,
    "image_scrapers": ("matplotlib",),
    "min_reported_time": 1,
    "remove_config_comments": True,
    "reset_modules": ("matplotlib", "figure_style.use"),
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,  # their pages load scripts from elsewhere
    "thumbnail_size": (400, 280),
}
