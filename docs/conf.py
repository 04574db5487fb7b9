"""Settings of Sphinx: the pages of the site are the Markdown files and notebooks of the whole checkout."""

from importlib import metadata
from pathlib import Path

project = "tb2rl"
author = "the tb2rl developers"
version = release = metadata.version("tb2rl")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
root_doc = "docs/index"
# The files of the folders are their pages.
include_patterns = ["*.md", "docs/**", "tb2rl/**/*.md", "agents/*.md", "configs/*.md", "zoo/*.ipynb"]
include_patterns += ["zoo/README.md", "zoo/*/README.md"]
exclude_patterns = ["tb2rl/deploy/folder.md", ".*", "runs", "tests", "build"]

html_theme = "furo"
html_title = "tb2rl"
html_copy_source = False
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
default_role = "code"  # single backticks in docstrings
autodoc_typehints = "description"
autodoc_member_order = "bysource"
copybutton_prompt_text = "$ "


def setup(app):
    """Let the site's first address be that of its first page."""
    app.connect("build-finished", _write_redirect)


def _write_redirect(app, error):
    if error is None and app.builder.name == "html":
        redirect = '<meta http-equiv="refresh" content="0; url=README.html">'
        (Path(app.outdir) / "index.html").write_text(f"<!doctype html><title>{project}</title>{redirect}\n")
