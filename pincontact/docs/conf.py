"""Settings of the documentation site.

    pip install ".[docs]"
    sphinx-build -W -j auto pincontact/docs build/site

runs all notebooks. With `-t replays` it also runs the examples and embeds their replays in the gallery (a minute more);
those whose robots are not installed (extras `robots`, `mjcf`) are left out.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from docutils.nodes import SkipNode, image, raw
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.docutils import SphinxDirective

if TYPE_CHECKING:
    from docutils.nodes import Node, math, math_block
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parents[1]
# what notebooks import, and examples
sys.path[:0] = [str(DOCS), str(ROOT / "examples")]
os.environ["PYTHONPATH"] = os.pathsep.join([str(DOCS), *filter(None, [os.environ.get("PYTHONPATH")])])

import pincontact  # noqa: E402

project = "pincontact"
author = "The pincontact developers"
copyright = "The pincontact developers"
version = release = pincontact.__version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "myst_nb"]
# the first is that of generated pages
source_suffix = {".rst": "restructuredtext", ".md": "myst-nb"}
templates_path = ["_templates"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
# such as that kernels are being compiled
nb_output_stderr = "remove"

autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
toc_object_entries_show_parents = "hide"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"pincontact {release}"
html_show_sourcelink = False
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
    "secondary_sidebar_items": ["page-toc"],
}
html_sidebars: dict[str, list[str]] = {
    page: [] for page in ("changelog", "cheat_sheet", "coming_from", "faq", "gallery")
}


def setup(app: Sphinx) -> None:
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
    app.add_directive("replay", Replay)
    # before numpydoc reads them
    app.connect("autodoc-process-docstring", escape_markup, priority=400)
    app.connect("autodoc-process-bases", leave_public_bases)
    app.connect("builder-inited", make_folder)
    app.connect("build-finished", copy_replays)


def escape_markup(app: Sphinx, kind: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """What docstrings write plainly, as |F_t|, foot_0_face_-z and build(**parameters), is no markup."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            lines[number] = re.sub(r"\||(?<=\()\*\*|_(?=[-+]\w)", lambda found: "\\" + "\\".join(found[0]), line)


def leave_public_bases(app: Sphinx, name: str, thing: type, options: object, bases: list[type]) -> None:
    """Of what a class is derived from, readers know what has a page, and Python's own."""
    known = [
        base for base in bases if not base.__module__.startswith("pincontact") or base.__name__ in pincontact.__all__
    ]
    bases[:] = known or [object]


def visit_math(translator: HTML5Translator, node: math) -> None:
    """Formulas as MathML, which browsers draw without a network."""
    translator.body.append(tex2mathml(node.astext()))
    raise SkipNode


def visit_math_block(translator: HTML5Translator, node: math_block) -> None:
    translator.body.append(f"<p>{tex2mathml(node.astext(), as_block=True)}</p>")
    raise SkipNode


class Replay(SphinxDirective):
    """The replay of an example of the gallery, or its picture where the site is built without."""

    required_arguments = 1

    def run(self) -> list[Node]:
        name = self.arguments[0]
        if (Path(os.environ["PINCONTACT_SITE_FILES"]) / f"{name}.html").is_file():
            style = "width:100%;height:30em;border:0"
            frame = f'<iframe src="replays/{name}.html" title="Replay: {name}" loading="lazy" style="{style}"></iframe>'
            return [raw("", frame, format="html")]
        return [image(uri=f"figures/{name}.png", alt=name)]


def make_folder(app: Sphinx) -> None:
    """Where notebooks and examples write their files: a folder with the robots of `urdf/`."""
    folder = Path(app.outdir).parent / "site_files"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "urdf", folder / "urdf")
    os.environ["PINCONTACT_SITE_FILES"] = str(folder)
    # notebooks run without settings of the user's, and say nothing of how kernels are connected
    profile = folder / "ipython" / "profile_default"
    profile.mkdir(parents=True)
    (profile / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 'ERROR'\n", encoding="utf-8")
    os.environ["IPYTHONDIR"] = str(profile.parent)
    if app.tags.has("replays"):
        run_examples(folder)


def run_examples(folder: Path) -> None:
    """The replays of the gallery, each as the page NAME.html."""
    import gallery

    for name in gallery.SHOWN:
        try:
            with redirect_stdout(StringIO()):
                page = gallery.replay(name, folder)
        except (RuntimeError, ImportError) as error:
            print(f"left out {name}: {error}")
            continue
        page.rename(folder / f"{name}.html")


def copy_replays(app: Sphinx, failure: Exception | None) -> None:
    """Put the pages that notebooks and examples wrote beside the site's own."""
    if failure is None and app.builder.format == "html":
        target = Path(app.outdir) / "replays"
        target.mkdir(exist_ok=True)
        for page in Path(os.environ["PINCONTACT_SITE_FILES"]).glob("*.html"):
            shutil.copy(page, target)
