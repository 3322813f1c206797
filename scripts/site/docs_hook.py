"""A hook of MkDocs (see mkdocs.yml): adds Mermaid, which draws the diagrams, to the site's files.

Mermaid comes from the wheel of NiceGUI, which bundles it as JavaScript modules. NiceGUI itself is neither
imported nor complete: requirements-docs.lock installs it without its dependencies.
"""

from importlib.util import find_spec
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

TARGET = "javascripts/mermaid"
"""Folder in the site, beside the script that loads it."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the modules of Mermaid to the files of the site."""
    found = find_spec("nicegui")
    if found is None or found.origin is None:
        raise PluginError("nicegui, which brings Mermaid, is not installed: use `make docs`")
    folder = Path(found.origin).parent / "elements" / "mermaid" / "dist"
    modules = sorted(folder.glob("*.js"))
    if not any(module.name == "index.js" for module in modules):
        raise PluginError(f"no Mermaid in {folder}: expected nicegui as pinned in requirements-docs.lock")
    for module in modules:
        files.append(File.generated(config, f"{TARGET}/{module.name}", abs_src_path=str(module)))
    return files
