"""The pages of the repository as a static site: ``python -m odt_plugins.pages site/``.

`write_sources` lays out what Sphinx reads: every page of the repository where it stands, with its
pictures, the public names with their docstrings (`python_page`), and every command with its flags
(`commands_page`). `build` lets Sphinx make HTML of them, with a search, and takes a fault in a page
for an error. This room needs the extra of that name and a checkout; it is no part of the wheel.

Source: Sphinx reads Markdown by MyST and docstrings by napoleon; furo is the theme.
"""
