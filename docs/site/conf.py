"""Configuration of the guides' site: `make docs` builds docs/ into build/guides."""

project = "dropstitch"
copyright = "the dropstitch authors, Apache-2.0"
extensions = ["myst_nb"]
root_doc = "guides/index"
exclude_patterns = ["site", "schema", "notebooks/bundle_1dof"]

# Headings are addressed like on a code host, so that the same links work in both.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
suppress_warnings = ["myst.header"]  # decisions.md and safety.md skip a level on purpose

# Every notebook is run while the site is built; an error is an error of the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = False

html_theme = "furo"
html_title = "dropstitch"
html_extra_path = ["extra"]
html_static_path = ["static"]
html_css_files = ["guides.css"]
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
pygments_dark_style = "github-dark"
