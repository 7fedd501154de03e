"""Configuration of the guides' site: `make docs` builds docs/ into build/guides."""

project = "dropstitch"
copyright = "the dropstitch authors, Apache-2.0"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "guides/index"
exclude_patterns = ["site", "schema", "notebooks/bundle_1dof"]

# Headings are addressed like on a code host, so that the same links work in both.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
# A field like `dof` belongs to several classes.
suppress_warnings = ["ref.python"]

# The notebooks are committed with their outputs; the tests run them.
nb_execution_mode = "off"

# The API: types stand in the docstrings, in the style of NumPy.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "dropstitch"
html_extra_path = ["extra"]
html_static_path = ["static"]
html_css_files = ["guides.css"]
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
pygments_dark_style = "github-dark"
