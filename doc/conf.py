"""Sphinx: ``sphinx-build -W -n doc doc/_build/html``; needs no network."""

import os
import re
import sys
import tempfile
from pathlib import Path

import sklearn_raacmm
from sklearn_raacmm._version import REPOSITORY
from sklearn_raacmm.datasets import fetch_panda_ball_socket, fetch_ur10_tracker

DOC = Path(__file__).resolve().parent
sys.path.insert(0, str(DOC))
from _glossary import link_terms, terms_of  # noqa: E402
from _results import substitutions  # noqa: E402
from _sphinx import with_sections, write_inventories  # noqa: E402

project = "sklearn_raacmm"
author = "The sklearn_raacmm developers"
project_copyright = author
version = release = sklearn_raacmm.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",  # links from the reference to the source
    "sphinx-mathjax-offline",  # formulas without a network, too
    "numpydoc",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "_templates", "**.ipynb", "**/README.md"]
templates_path = ["_templates"]
# Pages that say more of one subject are found where they are, and may be missing.
suppress_warnings = ["toc.empty_glob", "config.cache"]

autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "substitution"]
myst_substitutions = substitutions()  # measured numbers and tables, from results.json
myst_heading_anchors = 3
highlight_options = {"python": {"stripnl": True}}  # no empty line at the end of an example
copybutton_exclude = ".linenos, .gp, .go"
intersphinx_mapping = write_inventories(Path(tempfile.gettempdir()) / "sklearn_raacmm-inventories")
# What scikit-learn's metadata routing writes into docstrings of ours.
nitpick_ignore_regex = [("py:.*", r"metadata_routing"), ("std:.*", r"metadata_routing|sphx_glr_.*")]

# "On this page" has methods by their own names, which fit beside the page.
toc_object_entries_show_parents = "hide"
html_theme = "pydata_sphinx_theme"
html_title = "sklearn_raacmm"
html_favicon = "_static/logo.svg"
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_sidebars = {page: [] for page in ("index", "install", "get_started")}
html_theme_options = {
    "logo": {
        "text": project,
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo.svg",
        "alt_text": "",
    },
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 8,
    "footer_start": ["copyright"],
    "footer_end": [],
}

# Source and issues, as soon as `_version.py` names a public place.
if REPOSITORY is not None:
    html_theme_options["icon_links"] = [
        {"name": "Source", "url": REPOSITORY, "icon": "fa-solid fa-code-branch"},
        {"name": "Issues", "url": f"{REPOSITORY}/issues", "icon": "fa-solid fa-circle-question"},
    ]

# -- gallery ----------------------------------------------------------------------------------

# Real data are read from where the tests have them, else from scikit-learn's data folder; the
# examples that need them are shown without being run where they are in neither.
beside = DOC.parent.parent / "shared" / "data"
home = os.environ.get("SKLEARN_RAACMM_DATA", beside if beside.is_dir() else None)
try:
    fetch_panda_ball_socket(data_home=home, download_if_missing=False)
    fetch_ur10_tracker(data_home=home, download_if_missing=False)
    have_real_data = True
    if home is not None:
        os.environ["SCIKIT_LEARN_DATA"] = str(home)  # where the examples look for them
except OSError:
    have_real_data = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "auto_examples",
    "filename_pattern": "/plot_" if have_real_data else "/plot_(?!real)",
    "ignore_pattern": r"(^|/)_",
    "within_subsection_order": "_sphinx.GalleryOrder",
    "doc_module": ("sklearn_raacmm",),
    "backreferences_dir": "generated/backreferences",
    "remove_config_comments": True,
    "show_memory": False,
    "thumbnail_size": (640, 448),
    "default_thumb_file": str(DOC / "images" / "not_run.png"),  # where data are missing
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1,
}


# Full names of what docstrings name by the last part; the reference has results in full.
LISTED = re.findall(r"^   (\w+\.\w+)$", (DOC / "api.rst").read_text(encoding="utf-8"), re.MULTILINE)
FULL = {n.split(".")[-1]: f"sklearn_raacmm.{n}" for n in (*sklearn_raacmm.__all__, *LISTED)}


def of_the_package(app, env, node, contnode):
    """Find a name of the package that a docstring gives by itself."""
    name = node.get("reftarget", "")
    if node.get("refdomain") == "py" and name in FULL:
        return env.get_domain("py").resolve_xref(
            env, node["refdoc"], app.builder, node["reftype"], FULL[name], node, contnode
        )
    return None


def gallery_in_sections(app, docname, source):
    """Put the gallery's pictures under the headings of their sections."""
    if docname == "auto_examples/index":
        source[0] = with_sections(source[0])


def of_a_list(app, what, name, obj, options, lines):
    """Say what the list of types is for, where Python would say what a list is."""
    if name == "sklearn_raacmm.export.TRUSTED_TYPES":
        lines[:] = ["Types that skops may build when it loads a model of this package."]


def with_glossary(app, tree, docname):
    """Link terms of the pages to the glossary, each where a page uses it first."""
    if "/" in docname and not docname.startswith("user_guide/"):
        return  # the reference and the gallery
    terms = terms_of(tree if docname == "glossary" else app.env.get_doctree("glossary"))
    if docname != "glossary":
        link_terms(tree, terms, app.builder.get_relative_uri(docname, "glossary"))


def of_their_own_pages(app, pagename, templatename, context, doctree):
    """Mend the links from sources: viewcode takes all names of a file for those of one module."""
    if pagename.startswith("_modules/"):
        link = r'(generated/([\w.]+\.(\w+))\.html#)[\w.]+?\.\3((?:\.\w+)?")'
        context["body"] = re.sub(link, r"\1\2\4", context["body"])


def setup(app):
    """Connect to Sphinx."""
    app.connect("autodoc-process-docstring", of_a_list)
    app.connect("missing-reference", of_the_package)
    app.connect("source-read", gallery_in_sections)
    app.connect("doctree-resolved", with_glossary)
    app.connect("html-page-context", of_their_own_pages)
