"""Show links that leave docs/ as plain file names: on GitHub they lead to the file, which the site lacks."""

import logging
import os
import re
from pathlib import Path
from typing import Any

LOG = logging.getLogger("mkdocs.hooks.links")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((\.\./[^)#\s]+)(?:#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Return a page whose links to files outside docs/ are the files' names."""
    docs = Path(config.docs_dir)
    folder = (docs / page.file.src_uri).parent

    def named(found: re.Match[str]) -> str:
        target = Path(os.path.normpath(folder / found[2]))
        if target.is_relative_to(docs):
            return found[0]
        if not target.exists():
            LOG.warning("%s links to %s, which does not exist", page.file.src_uri, found[2])
        name = f"`{target.relative_to(docs.parent)}`"
        return name if found[1].strip("`") in (target.name, name.strip("`")) else f"{found[1]} ({name})"

    return LINK.sub(named, markdown)
