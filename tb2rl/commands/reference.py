"""Pages of the reference in Markdown, from the templates in this folder."""

from pathlib import Path
from typing import Any

import jinja2


def markdown(page: str, **values: Any) -> str:
    """Render the template of a page."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(f"{page}.md.jinja").render(values)
