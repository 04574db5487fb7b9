"""The <state> of an SDF world: the poses of its models when it was saved, and models that came and went before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from xml.etree.ElementTree import Element

import numpy as np

from tb2rl.core.errors import InputError
from tb2rl.worlds.formats.markup import name_of, numbers, text_of
from tb2rl.worlds.formats.poses import matrix


class State:
    """The state of a world or a model.

    Gazebo saves the poses of models, of models within models and of links all in the world's frame.

    Args:
        element: The <state>, or a <model> of it; None if there is none.
        parent: The state that contains this one.
    """

    def __init__(self, element: Element | None, parent: State | None = None) -> None:
        self._element = Element("state") if element is None else element
        self._parent = parent
        self.depth: int = 0 if parent is None else parent.depth + 1  # models within models
        self._label: str = "" if parent is None else f"{parent._label}{name_of(self._element)}/"
        self._parts = {f"{part.tag} {name_of(part)}": part for part in self._element if part.tag in ("model", "link")}
        self._used: set[str] = set()
        self._within: list[State] = []
        self._deleted = {text_of(name) for name in self._element.findall("deletions/name")}

    @property
    def pose(self) -> np.ndarray | None:
        """Pose of the model in the world, shape (4, 4); None: its own pose counts."""
        return _pose(self._element)

    @cached_property
    def scale(self) -> Sequence[float]:
        """Scale of the model's shapes along their axes, three numbers."""
        scale = self._element.find("scale")
        if scale is None:
            return (1.0, 1.0, 1.0) if self._parent is None else self._parent.scale
        factors = numbers(scale, 3)
        if min(factors) <= 0:
            raise InputError(f"<scale> of {self._label} must be above 0, got {text_of(scale)}")
        return factors

    @property
    def inserted(self) -> list[Element]:
        """Models that were inserted while the world ran."""
        return self._element.findall("insertions/model")

    def deletes(self, model: str) -> bool:
        """Whether a model was deleted while the world ran."""
        return model in self._deleted

    def of(self, model: Element) -> State:
        """State of a model within."""
        self._within.append(State(self._part(model), self))
        return self._within[-1]

    def link(self, link: Element) -> np.ndarray | None:
        """Pose of a link of the model in the world, shape (4, 4); None: its own pose counts."""
        part = self._part(link)
        return None if part is None else _pose(part)

    def _part(self, element: Element) -> Element | None:
        key = f"{element.tag} {name_of(element)}"
        self._used.add(key)
        return self._parts.get(key)

    def missing(self) -> Iterator[str]:
        """Names in the state that were never looked up, because the world does not have them."""
        yield from (f"{self._label}{name_of(part)}" for key, part in self._parts.items() if key not in self._used)
        for state in self._within:
            yield from state.missing()


def _pose(element: Element) -> np.ndarray | None:
    pose = element.find("pose")
    return None if pose is None else matrix(pose)
