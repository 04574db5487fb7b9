"""Reader of Gazebo worlds: SDF files (http://sdformat.org/spec), cut at the height of the laser.

Obstacles are the collision shapes of all models. A `WorldWarning` lists unsupported parts.
"""

import os
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from tb2rl.core.errors import InputError, one_line
from tb2rl.worlds.formats.imports import ImportOptions, complete_world, warn
from tb2rl.worlds.formats.markup import element_name, element_text, parse_numbers, parse_sizes, read_xml
from tb2rl.worlds.formats.poses import IDENTITY, Scope, State
from tb2rl.worlds.formats.slices import OmittedShape, Slice, is_upright, load_mesh
from tb2rl.worlds.world import World

# Gazebo's environment variables with folders of models.
VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")
_MAX_PARTS = 20_000  # limit of models and shapes, because small files can include each other very often
_NOT_FOUND = "models and meshes were not found, and nothing is downloaded; add their folders to GAZEBO_MODEL_PATH"


def read_sdf(path: Path, options: ImportOptions) -> World:
    """Read a world from an SDF file (.world or .sdf) of a world or a model.

    Raises:
        InputError: If the file is not SDF, or its world is invalid.
    """
    root = read_xml(path)
    if root.tag != "sdf":
        raise InputError(f"{path} is not SDF: it begins with <{root.tag[:40]}>, not <sdf>")
    reader = _Reader(path, options)
    try:
        reader.read(root)
    except InputError as error:
        raise InputError(f"world {path.stem}: {error}") from None
    except RecursionError:
        raise InputError(f"world {path.stem}: models, files or frames nest too deep, or contain themselves") from None
    for reason, names in reader.omissions.items():
        listed = [f"{name} ({count} times)" if count > 1 else name for name, count in names.items()]
        warn(f"world {path.stem}: {reason}: {', '.join(listed)}")
    return complete_world(path.stem, reader.slice.boxes, reader.slice.posts, options, description=f"from {path.name}")


class _Reader:
    """Reader of a world with all included files; collects its obstacles in `slice`."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        self.omissions: defaultdict[str, Counter[str]] = defaultdict(Counter)  # names by reason
        self.slice = Slice(options.laser_height)
        self._path, self._model_path, self._part_count = path, ModelPath(path, options.model_path), 0
        self._read_xml, self._load_mesh = cache(read_xml), cache(load_mesh)
        self._find_model = cache(self._model_path.find_model)

    def read(self, root: Element) -> None:
        """Read the first world of an <sdf>, or its models if it has no world."""
        worlds = root.findall("world")
        for world in worlds[1:]:
            self._omit("only the first world of the file is read, not", element_name(world))
        if not worlds and root.find("model") is None:
            raise InputError("the file has neither a <world> nor a <model>")
        container = worlds[0] if worlds else root
        state, scope = State(container.find("state"), np.ones(3)), Scope(container, IDENTITY, self._omit)
        self._read_scope(scope, self._path, state)
        for model in state.inserted:
            self._read_model(model, scope, self._path, state)
        for name in sorted(state.unused):
            self._omit("the <state> has unknown models", name)

    def _read_scope(self, scope: Scope, file: Path, state: State) -> None:
        """Read the models in a world or a model."""
        self._omit_plugins(scope.element)
        for child in scope.element:
            if child.tag == "model":
                self._read_model(child, scope, file, state)
            elif child.tag == "include":
                self._read_include(child, scope, file, state)
            elif child.tag in ("actor", "population", "road"):  # they could be obstacles
                self._omit("unsupported elements", f"{element_name(child)} (<{child.tag}>)")

    def _read_model(self, model: Element, parent: Scope, file: Path, state: State) -> None:
        """Read a model in a scope, unless the saved state of the scope lists the model as deleted."""
        if element_name(model) in state.deleted:
            return
        self._part_count += 1 + len(model.findall("link/collision"))
        if self._part_count > _MAX_PARTS:
            raise InputError(f"the file has more than {_MAX_PARTS} models and shapes, with all included files")
        state = state.of(model)
        pose = state.pose
        if pose is None:
            pose, frame = parent.world_pose(model), model.get("placement_frame")
            frame_pose = Scope(model, IDENTITY, self._omit).frame_pose(frame, element_name(model)) if frame else None
            pose = pose if frame_pose is None else pose @ np.linalg.inv(frame_pose)
        scope = Scope(model, pose, self._omit)
        for link in model.findall("link"):
            self._omit_plugins(link)
            link_pose = state.of(link).pose
            link_pose = scope.world_pose(link) if link_pose is None else link_pose
            for collision in link.findall("collision"):
                label = f"{element_name(model)}/{element_name(collision)}"
                self._add_collision(collision, scope.world_pose(collision, link_pose), state.scale, file, label)
        self._read_scope(scope, file, state)

    def _read_include(self, include: Element, parent: Scope, file: Path, state: State) -> None:
        """Read the models of an <include>; the name and pose of the <include> take precedence."""
        uri = element_text(include.find("uri"))
        sdf = self._find_model(uri, file.parent)
        if sdf is None:
            self._omit(_NOT_FOUND, uri or element_name(include))
            return
        self._omit_plugins(include)
        overrides = {tag: text for tag in ("name", "placement_frame") if (text := element_text(include.find(tag)))}
        for child in self._read_xml(sdf):
            if child.tag == "model":
                model = Element("model", {**child.attrib, **overrides})
                model.extend([*include.findall("pose"), *child])  # the first <pose> is used
                self._read_model(model, parent, sdf, state)
            elif child.tag != "light":
                self._omit("unsupported elements", f"{element_name(child)} in {sdf.name}")

    def _add_collision(self, collision: Element, pose: np.ndarray, scale: np.ndarray, file: Path, label: str) -> None:
        """Add the shape of a <collision>; several <polyline> elements are one shape."""
        shapes = collision.findall("geometry/*") or [Element("empty")]
        try:
            if shapes[0].tag == "mesh":
                label = f"{label} ({element_text(shapes[0].find('uri'))})"
                self._add_mesh(shapes[0], pose, scale, file)
            else:
                _add_shape(shapes, pose, scale, self.slice)
        except OmittedShape as reason:
            self._omit(str(reason), label)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None

    def _add_mesh(self, shape: Element, pose: np.ndarray, scale: np.ndarray, file: Path) -> None:
        path = self._model_path.find(element_text(shape.find("uri")), file.parent)
        if path is None:
            raise OmittedShape(_NOT_FOUND)
        if shape.find("submesh") is not None:
            self._omit("the whole mesh is used instead of a <submesh>", path.name)
        mesh_scale = np.array(parse_sizes(shape, "scale", 3)) if shape.find("scale") is not None else np.ones(3)
        self.slice.add_mesh(self._load_mesh(path), pose, mesh_scale * scale)

    def _omit(self, reason: str, name: str) -> None:
        self.omissions[reason][name] += 1

    def _omit_plugins(self, owner: Element) -> None:
        for plugin in owner.findall("plugin"):
            name = owner.get("name") or element_text(owner.find("name")) or element_text(owner.find("uri"))
            label = f"{plugin.get('name') or plugin.get('filename')} of {name}"
            self._omit("plugins do not run, so objects that they move stand still", label)


class ModelPath:
    """Search path of models, which resolves `model://`, `package://`, `file://` and relative URIs to local files.

    Models are searched in the folders of the setting `model_path`, of the environment variables of Gazebo, and near the
    world file. Nothing is downloaded or read from other folders, because world files are untrusted.

    Args:
        world: The world file.
        folders: Folders to search first.
    """

    def __init__(self, world: Path, folders: tuple[str, ...] = ()) -> None:
        paths = [*folders, *(folder for name in VARIABLES for folder in os.environ.get(name, "").split(os.pathsep))]
        world_folder = world.absolute().parent
        listed_folders = [Path(folder).absolute() for folder in paths if folder]
        # In TurtleBot3 and most other packages, worlds/ and models/ are in the same folder.
        self._folders = [*listed_folders, world_folder, world_folder / "models", world_folder.parent / "models"]

    def find(self, uri: str, within: Path) -> Path | None:
        """Find the file or folder of a URI, None if there is none; `within` is the folder of the SDF file with the URI.

        Raises:
            InputError: If the URI leaves the search path.
        """
        scheme, _, quoted = uri.rpartition("://")
        location = unquote(quoted)
        candidates = [folder / location.lstrip("/") for folder in self._folders]
        if scheme not in ("model", "package"):
            candidates.insert(0, within / location)
        paths = [self._checked(candidate, within) for candidate in candidates if uri]
        return next((path for path in paths if os.path.exists(path)), None)  # noqa: PTH110 (`Path.exists` raises for long names)

    def find_model(self, uri: str, within: Path) -> Path | None:
        """Find the SDF file of a model. In a folder, this is the file with the highest version in model.config.

        Raises:
            InputError: If the URI or model.config leave the search path.
        """
        found = self.find(uri, within)
        if found is None or not found.is_dir():
            return found
        config = found / "model.config"
        versions = list(read_xml(config).iter("sdf")) if config.is_file() else []
        name = element_text(max(versions, key=_version)) if versions else ""
        model = self._checked(found / (name or "model.sdf"), found)
        return model if model.is_file() else None

    def _checked(self, path: Path, within: Path) -> Path:
        """Normalise a path; raise an `InputError` if the result is outside of `within` and of the search path."""
        path = Path(os.path.normpath(path))  # not `resolve`, because ROS workspaces are full of symbolic links
        if not any(path.is_relative_to(folder) for folder in (within, *self._folders)):
            raise InputError(one_line(f"{path} is outside of the model path; add its folder to the model path"))
        return path


def _version(sdf: Element) -> tuple[int, ...]:
    return tuple(int(part) for part in sdf.get("version", "").split(".") if part.isdecimal())


def _add_shape(shapes: list[Element], pose: np.ndarray, scale: np.ndarray, cut: Slice) -> None:
    """Add a shape to a slice: all <polyline> elements together, or a single element other than a mesh."""
    shape = shapes[0]
    if shape.tag == "plane":  # a horizontal plane, such as the ground, is no obstacle
        normal = shape.find("normal")
        if not is_upright(pose) or (normal is not None and parse_numbers(normal, 3)[:2] != [0.0, 0.0]):
            raise OmittedShape("only horizontal planes are supported")
    elif shape.tag == "box":
        cut.add_box(pose, np.array(parse_sizes(shape, "size", 3)) * scale / 2)
    elif shape.tag == "cylinder":
        (radius,), (length,) = parse_sizes(shape, "radius", 1), parse_sizes(shape, "length", 1)
        cut.add_cylinder(pose, radius * max(scale[:2]), length * scale[2])
    elif shape.tag == "sphere":
        (radius,) = parse_sizes(shape, "radius", 1)
        cut.add_sphere(pose, radius * max(scale))
    elif shape.tag == "polyline":
        _add_polyline(shapes, pose, scale, cut)
    elif shape.tag != "empty":
        raise OmittedShape(f"<{shape.tag}> shapes are not supported")


def _add_polyline(lines: list[Element], pose: np.ndarray, scale: np.ndarray, cut: Slice) -> None:
    """Add the area inside an odd number of lines; as in Gazebo, a line inside another line is the outline of a hole."""
    (height,) = np.array(parse_sizes(lines[0], "height", 1)) * scale[2]
    corners = [[np.array(parse_numbers(point, 2)) * scale[:2] for point in line.findall("point")] for line in lines]
    outlines = [shapely.Polygon(points) if len(points) > 2 else shapely.Polygon() for points in corners]
    if not all(outline.is_valid and outline.area > 0 for outline in outlines):
        raise InputError("a <polyline> must have at least three <point>, and an outline without crossings")
    area = outlines[0]
    if len(outlines) > 1:
        rings = shapely.multilinestrings([outline.exterior for outline in outlines])
        if not rings.is_simple:
            raise InputError("the <polyline> elements of a shape must not touch or cross each other")
        area = shapely.build_area(rings)
    if is_upright(pose):
        # Raises `OmittedShape` if the laser passes above or below.
        cut.check_height(*sorted((pose[2, 3], pose[2, 3] + pose[2, 2] * height)))
        cut.add_polygons(shapely.transform(area, lambda points: points @ pose[:2, :2].T + pose[:2, 3]))
    else:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(area))
        cut.add_prisms(pose, [np.array(part.exterior.coords[:3]) for part in triangles], 0.0, height)
