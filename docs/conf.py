"""Settings of the documentation site: `make docs`."""

import os
import sys
from pathlib import Path

from cosim import __version__

project = "fmu-retune"
copyright = "the authors of fmu-retune; MIT licence"
release = version = __version__
extensions = ["myst_nb", "sphinx.ext.autodoc"]
exclude_patterns = ["README.md", "evaluation.in.md", "evaluation", "_build"]
nitpicky = False

html_theme = "pydata_sphinx_theme"
html_context = {"default_mode": "auto"}
html_title = "fmu-retune"
html_theme_options = {
    "github_url": "https://github.com/fmu-retune/fmu-retune",
    "show_toc_level": 2,
    "navbar_end": ["theme-switcher", "navbar-icon-links"],
    "secondary_sidebar_items": ["page-toc"],
}
html_static_path = ["_static"]
html_css_files = ["fonts.css"]  # the reader's own fonts: none are loaded
html_show_sourcelink = False

myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # scenario.md leaves a level out, so that its keys are small
myst_enable_extensions = ["colon_fence"]
nb_execution_mode = "cache" if os.environ.get("DOCS_CACHE") else "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True

_SOURCE = "https://github.com/fmu-retune/fmu-retune/blob/main/"
# Notebooks call `retune`, which is beside this Python.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")


def setup(app):
    app.connect("builder-inited", _write_command_line)
    app.connect("source-read", _link_to_sources)
    app.connect("autodoc-process-docstring", _as_text)


def _link_to_sources(app, name, content):
    """Links out of docs/, which work on GitHub, lead there."""
    content[0] = content[0].replace("](../", f"]({_SOURCE}")


def _as_text(app, what, name, thing, options, lines):
    """Docstrings are text with code in backquotes: nothing else in them is markup."""
    for i, line in enumerate(lines):
        lines[i] = (
            line.replace("\\", "\\\\").replace("*", "\\*").replace("|", "\\|").replace("`", "``").replace("_ ", "\\_ ")
        )


def _write_command_line(app):
    """Writes the page of all commands and options, from the parser."""
    os.environ["COLUMNS"] = "100"
    from cosim.terminal.options import make_parser

    parser = make_parser()
    (commands,) = (a for a in parser._actions if hasattr(a, "choices") and isinstance(a.choices, dict))
    parts = ["# The command line", "What `retune COMMAND --help` prints. [Commands](../commands.md) explains them."]
    for name, one in commands.choices.items():
        parts.append(f"## retune {name}\n\n```text\n{one.format_help().strip()}\n```")
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    (folder / "command-line.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
