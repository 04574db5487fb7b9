"""The <state> of an SDF world: where its models were when it was saved, and what came and went before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.markup import name_of, numbers, text_of
from tb2rl.worlds.formats.poses import matrix


class State:
    """What a state says about a world, or about one model.

    Gazebo saves the poses of models, of models within models and of links all in the world's frame.

    Args:
        element: The <state>, or a <model> of it; None: nothing is said.
        above: The state that this one is part of.
    """

    def __init__(self, element: Element | None, above: State | None = None) -> None:
        self._element = element
        self.depth: int = 0 if above is None else above.depth + 1  # models within models
        self._label: str = "" if above is None or element is None else f"{above._label}{name_of(element)}/"
        self._parts: dict[str, Element] = {}
        self._used: set[str] = set()
        self._within: list[State] = []
        for part in () if element is None else element:
            if part.tag in ("model", "link"):
                self._parts[f"{part.tag} {name_of(part)}"] = part
        self._gone = set() if element is None else {text_of(name) for name in element.findall("deletions/name")}
        self._above = above

    @property
    def pose(self) -> np.ndarray | None:
        """Where the model stands in the world, shape (4, 4); None: where its own pose says."""
        return None if self._element is None else _pose(self._element)

    @cached_property
    def scale(self) -> Sequence[float]:
        """By how much the model's shapes were drawn out along their axes, three numbers."""
        scale = None if self._element is None else self._element.find("scale")
        if scale is None:
            return (1.0, 1.0, 1.0) if self._above is None else self._above.scale
        said = numbers(scale, 3)
        if min(said) <= 0:
            raise InputError(f"<scale> of {self._label} must be above 0, got {text_of(scale)}")
        return said

    @property
    def inserted(self) -> list[Element]:
        """The models that came into the world after it began."""
        return [] if self._element is None else self._element.findall("insertions/model")

    def deletes(self, model: str) -> bool:
        """Whether a model had gone from the world."""
        return model in self._gone

    def of(self, model: Element) -> State:
        """What is said about a model within."""
        key = f"model {name_of(model)}"
        state = State(self._parts.get(key), self)
        self._used.add(key)
        self._within.append(state)
        return state

    def link(self, link: Element) -> np.ndarray | None:
        """Where a link of the model is in the world, shape (4, 4); None: where its own pose says."""
        key = f"link {name_of(link)}"
        self._used.add(key)
        return _pose(self._parts[key]) if key in self._parts else None

    def missing(self) -> Iterator[str]:
        """What the state names, though nobody asked for it: it was not in the world."""
        for key, part in self._parts.items():
            if key not in self._used:
                yield f"{self._label}{name_of(part)}"
        for state in self._within:
            yield from state.missing()


def _pose(element: Element) -> np.ndarray | None:
    pose = element.find("pose")
    return None if pose is None else matrix(pose)
