"""The manual: pages of docs/, made by Sphinx (tools/manual.py)."""

project = "SVR-GS"
extensions = ["myst_parser"]
root_doc = "manual/index"
PAGES = (
    "blender", "selection", "rendering", "jobs", "pruning", "figures", "forecast", "formats", "command-line",
    "farm", "methods", "platforms",
)  # fmt: skip
include_patterns = ["manual/index.md", "pictures/**", *(f"{page}.md" for page in PAGES)]
gettext_compact = "manual"
myst_heading_anchors = 4
suppress_warnings = ["myst.xref_missing"]  # pages that are not in it are named without a link
html_theme = "furo"
html_title = "SVR-GS"
html_show_sourcelink = html_copy_source = False
html_show_copyright = html_show_search_summary = html_show_sphinx = False
