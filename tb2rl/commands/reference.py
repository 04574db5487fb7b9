"""Pages of the reference in Markdown, from the templates in this folder."""

import argparse
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import jinja2


def markdown(page: str, **values: Any) -> str:
    """Render the template of a page."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(f"{page}.md.jinja").render(values)


def commands_page(modules: Mapping[str, str]) -> str:
    """The page of commands and their sub-commands; it uses no help of argparse, which depends on Python's version."""
    sections: list[tuple[str, str, list[argparse.Action]]] = []  # name, text, arguments
    for name, module in modules.items():
        found = import_module(module)
        actions = found.main.parser()._actions[1:]  # without --help
        sections.append((name, found.__doc__ or "", actions))
        for action in actions:
            if isinstance(action, argparse._SubParsersAction):
                texts = {choice.dest: choice.help or "" for choice in action._choices_actions}
                sections += [(f"{name} {sub}", texts[sub], p._actions[1:]) for sub, p in action.choices.items()]
    return markdown("commands", sections=sections)
