"""How the documentation is built: `make docs`, without a network, every warning an error."""

from __future__ import annotations

import atexit
import gc
import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "src"), str(HERE / "extensions")]

# The trees of all pages stay to the end: going through them over and over is a quarter of the time.
gc.set_threshold(200_000)

import warm  # noqa: E402

import tridentify  # noqa: E402

project = "tridentify"
copyright = "tridentify developers, MIT licence"
release = tridentify.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "command",
    "mathml",
    "public_names",
]
exclude_patterns = ["extensions", "static"]
nitpicky = True
# The build looks nothing up elsewhere, so names of other packages have no page to go to. What
# stands in single backticks in a docstring is a link where the reference has that name, else code.
nitpick_ignore_regex = [
    ("py:(class|exc)", r"(numpy|np|npt|scipy|matplotlib|pathlib|collections|os|enum|types)\..+"),
    ("py:class", r"(concurrent|typing|io|functools|datetime|fractions)\..+"),
    # names of types (Array, Truth) and what stands behind the seams
    ("py:class", r"(\w+|tridentify\.online\.(estimator|layout|search|state)\.\w+)"),
    ("py:class", r".+\.(Executor|Reached|Located|Ending|Patience|LoopTaken|PartedFile|Wanted)"),
    ("py:class", r"tridentify\.estimation\.answer\.decision\.(DecisionKind|KnownDecision)"),
    ("py:class", r"tridentify\.record\.formats\.summary\.ChannelSummary"),
    ("py:class", r"tridentify\.fleet\.(store\.Store|together\.Without|working\.Question)"),
    ("py:obj", r".+"),
]
default_role = "py:obj"
suppress_warnings = ["config.cache"]

# ---------------------------------------------------------------------------------- pages that run
# The pages' kernels: the package of this checkout and no profile of the user's.
# A figure that a cell ends with is shown, as after %matplotlib inline.
PROFILE = """
c.InteractiveShellApp.matplotlib = "inline"
c.InlineBackend.figure_formats = {"svg"}
c.InlineBackend.print_figure_kwargs = {"bbox_inches": None}
c.HistoryManager.enabled = False
c.IPKernelApp.log_level = 40
"""
kernels = Path(tempfile.mkdtemp(prefix="docs-kernels-"))
OWNER = os.getpid()


def clean() -> None:
    """Only the process that made the folder removes it, not those that it forks."""
    if os.getpid() == OWNER:
        shutil.rmtree(kernels, ignore_errors=True)


atexit.register(clean)
(kernels / "profile_default").mkdir()
(kernels / "profile_default" / "ipython_config.py").write_text(PROFILE)
os.environ["IPYTHONDIR"] = str(kernels)
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(HERE.parent / "src"), str(HERE.parent / "examples")]
)
os.environ["DOCS_ROOT"] = str(HERE.parent)
os.environ.pop("MPLBACKEND", None)
os.environ["DOCS_WARM"] = warm.start(kernels)
if os.environ["DOCS_WARM"]:
    os.environ["JUPYTER_PATH"] = str(kernels)
    spec = {
        "argv": [*warm.COMMAND, os.environ["DOCS_WARM"], "kernel", "-f", "{connection_file}"],
        "display_name": "Python 3",
        "language": "python",
    }
    (kernels / "kernels" / "python3").mkdir(parents=True)
    (kernels / "kernels" / "python3" / "kernel.json").write_text(json.dumps(spec))
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_execution_in_temp = True
nb_merge_streams = True
nb_render_markdown_format = "myst"
nb_execution_show_tb = True
nb_render_text_lexer = "text"

# --------------------------------------------------------------------------------------- reference
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    "ArrayLike": "array_like",
    **dict.fromkeys(("Array", "Complex", "Flags"), "ndarray"),
    **{name: name for name in ("Intersample", "Polynomials", "Choice", "InitialState", "Axes")},
}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_use_admonition_for_notes = False
napoleon_custom_sections = [("Raises", "params_style"), ("Attributes", "params_style")]

# -------------------------------------------------------------------------------------------- look
html_theme = "furo"
html_title = f"tridentify {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
copybutton_selector = "div.highlight:not(.output) pre"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_exclude = ".linenos, .gp, .go"
html_theme_options = {"navigation_with_keys": True}
