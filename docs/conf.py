"""How Sphinx builds the documentation: `make docs`, without a network."""

from __future__ import annotations

import sys
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

from sphinx.ext import autosummary

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS / "extensions"))

project = "periscopy_sim"
author = "the periscopy_sim authors"
project_copyright = author
about = metadata("periscopy-sim")
release = version = about["Version"]
links = dict(each.split(", ", 1) for each in about.get_all("Project-URL", []))

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "pages_of_the_repository",
    "checked_links",
    "commands_page",
    "docstrings",
    "phone_tables",
    "phone_widths",
    "api_groups",
]
exclude_patterns = ["extensions", "first_hour.ipynb", "repository/readme.txt"]
templates_path = ["templates"]
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}

# Pages that code hosts show too: plain Markdown, with the anchors that these hosts make.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "html_image"]
pages_of_the_repository = {
    "README.md": "index",
    "benchmarks/README.md": "leaderboard",
    "scenes/README.md": "scene_files",
    "scenes/ambient/README.md": "ambient_places",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changes",
}

default_role = "py:obj"  # a docstring's `name` is a link where there is such a name
# Attributes of several classes may share a name, as `across` does; no link is then made wrong.
suppress_warnings = ["ref.python"]
autosummary_generate = True
autosummary_imported_members = True
autosummary.WELL_KNOWN_ABBREVIATIONS += ("Sec.", "Eq.", "Fig.")  # no summary ends there
autodoc_typehints = "none"  # the docstrings give shapes and units, the signature its types
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_mock_imports = ["torch", "deepinv"]
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_attr_annotations = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "subsection_order": [
        f"../examples/{name}" for name in ("light", "reconstruction", "scenes", "evaluation")
    ],
    "within_subsection_order": "gallery_look.Order",
    "reset_modules": ("gallery_look.reset",),
    "reference_url": {"periscopy_sim": None},
    "doc_module": ("periscopy_sim",),
    "backreferences_dir": "api/examples",
    "inspect_global_variables": False,
    "abort_on_example_error": True,
    "only_warn_on_example_error": False,
    "remove_config_comments": True,
    "capture_repr": ("_repr_html_",),
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "write_computation_times": False,
    "image_srcset": ["2x"],
    "thumbnail_size": (560, 280),
}

html_theme = "pydata_sphinx_theme"
html_title = "periscopy_sim"
html_static_path = ["static"]
html_css_files = ["look.css"]
html_favicon = "static/mark.svg"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {
        "text": "periscopy_sim",
        "image_light": "static/mark.svg",
        "image_dark": "static/mark.svg",
    },
    "header_links_before_dropdown": 7,
    "navbar_align": "left",
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc", "sg_download_links"],
    "footer_start": ["about"],
    "footer_end": ["copyright"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_context = {"repository": links.get("Repository", "")}
toc_object_entries_show_parents = "hide"
html_sidebars = {page: [] for page in ("index", "start", "repository/leaderboard")}


def setup(app: Any) -> None:
    """Colour only comments in commands; Pygments takes the 0 of 0.01 for a number."""
    from pygments.lexer import RegexLexer
    from pygments.token import Comment, Text

    class Commands(RegexLexer):  # type: ignore[misc, unused-ignore]
        """Lines for a shell."""

        tokens = {"root": [(r"(?<!\S)#.*", Comment), (r"\s+|\S+", Text)]}  # noqa: RUF012

    for name in ("console", "sh"):
        app.add_lexer(name, Commands)
