"""Settings of the documentation. `make docs` builds it, without a network."""

import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

project = "circle2d-mj"
release = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["version"]
copyright = "the circle2d-mj maintainers, MIT licence"

extensions = ["myst_parser", "accessible", "made", "mathml"]
html_math_renderer = "mathml"
# Texts that other pages include are no pages.
exclude_patterns = ["_build", "_ext", "README.md", "made/hyperparameters", "made/metric.md"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
default_role = "code"
add_module_names = False
toc_object_entries_show_parents = "hide"
maximum_signature_line_length = 80
nitpicky = False

html_theme = "furo"
html_title = f"circle2d-mj {release}: a safe-RL suite"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_show_sphinx = False
html_copy_source = False
pygments_style = "default"
pygments_dark_style = "github-dark"
