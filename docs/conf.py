"""The documentation site: `sphinx-build -W --keep-going -b html docs docs/_build`."""

import sys
import warnings
from html import escape
from pathlib import Path

import ziamath
from docutils import nodes
from pydantic import BaseModel

import posegsa
import posegsa.config

posegsa.enable_fast_path()  # before an example of the gallery starts JAX
# Each example calls it again, when JAX has started.
warnings.filterwarnings("ignore", "enable_fast_path", posegsa.PosegsaWarning)

project = "posegsa"
author = "The posegsa authors"
project_copyright = author
release = version = posegsa.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "gallery/*.py", "gallery/**/*.md5", "live"]
default_role = "code"  # of docstrings
html_theme = "furo"
html_title = f"posegsa {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False

# Pages are written for a forge too: links to headings are made as a forge makes them.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units, which say more
autodoc_default_options = {"members": True, "exclude-members": "model_config"}
napoleon_numpy_docstring = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "within_subsection_order": "FileNameSortKey",
}


def drawn_equation(translator, node):
    """An equation as a drawing (SVG), which needs neither a script nor a network nor a font."""
    inline, tex = isinstance(node, nodes.math), node.astext()
    drawing = ziamath.Latex(tex, inline=inline, size=18, color="currentColor")
    tag, place = ("span", drawing.getyofst()) if inline else ("div", 0)
    translator.body.append(
        f'<{tag} class="math" role="img" aria-label="{escape(tex)}" '
        f'style="vertical-align: {place:.2f}px">{drawing.svg()}</{tag}>'
    )
    raise nodes.SkipNode


def headers_are_rst(app):
    """Keep the gallery from taking the README.md of a folder of data for a header of examples."""
    app.config.sphinx_gallery_conf["source_suffix"] = {".rst": "restructuredtext"}


def signature_of(app, what, name, thing, options, signature, returned):
    """No signature for a class of settings, whose fields follow one by one, or for a protocol."""
    plain = what == "class" and (
        issubclass(thing, BaseModel | tuple) or getattr(thing, "_is_protocol", False)
    )
    return ("", None) if plain else None


def before_napoleon(app, what, name, thing, options, lines):
    """Keep the text of an attribute: napoleon takes what is before a colon for its type."""
    if what == "attribute" or (what == "property" and "Raises:" not in lines):
        app.env.temp_data[name] = list(lines)


def after_napoleon(app, what, name, thing, options, lines):
    """The text of an attribute, and the default of a setting, which its class does not show."""
    lines[:] = app.env.temp_data.pop(name, lines)
    module, _, field = name.rpartition(".")
    module, _, owner = module.rpartition(".")
    owner = getattr(sys.modules.get(module), owner, None)
    known = getattr(owner, "model_fields", {}) if what == "attribute" else {}
    if field in known and not known[field].is_required():
        default = known[field].get_default(call_default_factory=True)
        if not isinstance(default, BaseModel) and len(repr(default)) <= 80:
            last = max(i for i, line in enumerate(lines) if line)
            lines[last] += f" Default: ``{default!r}``."


def copy_live_page(app, exception):
    """The page that docs/live/build.py has built, with a link to the site around it."""
    if exception is None and app.builder.format == "html":
        folder = Path(app.outdir) / "live"
        folder.mkdir(exist_ok=True)
        page = (Path(app.srcdir) / "live" / "index.html").read_text("utf-8")
        link = '<p><a href="../index.html">posegsa</a></p>'
        (folder / "index.html").write_text(page.replace("<header>", f"<header>{link}", 1), "utf-8")


def setup(app):
    """Add the renderer of equations, and what autodoc and the gallery have no settings for."""
    app.connect("autodoc-process-signature", signature_of)
    app.connect("autodoc-process-docstring", before_napoleon, priority=400)
    app.connect("autodoc-process-docstring", after_napoleon, priority=600)
    app.connect("builder-inited", headers_are_rst, priority=100)
    app.connect("build-finished", copy_live_page)
    app.add_html_math_renderer("drawn", (drawn_equation, None), (drawn_equation, None))


html_math_renderer = "drawn"
